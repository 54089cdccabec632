"""Flight controllers: stiffness of their position loops, and treatment of set points.

A drone of mass m that is the error e [m] off its set point s answers with the force

    kp e + kd ė + ∫ ki e dt  (+ m s̈ and the cable force of the set points, with feed-forward),

level and upright apart. The values are those of the public firmwares at their default parameters:
Mellinger's law of the Crazyflie has gains in newtons, for any mass; the others' are per mass.
How far off drones fly was measured with the Crazyflie's firmware in a loop with simulated cables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

from hitchopt.errors import InputError, OneLine
from hitchopt.values import check_choice, form_of, units
from hitchopt.values.fields import Key, Kind, Record, documented, mapping_of, one_or_each

Pair = tuple[float, float]
"""One value level (x and y), one upright (z)."""

DAMPING_RATIO = 5.0 / 6.0
"""kd / (2 √(kp m)) where no damping is stated: gains of 36/s² and 10/s times the mass."""

INTEGRAL_TIME = 2.0
"""[s] kp / ki of an integral of which nothing else is stated."""

RETUNED = 0.05
"""[m] How far off drones of the stiffest loops fly: none is said to be closer."""

PULL_TIME = 0.02
"""[s] Velocity over acceleration of a steady level pull that the exported filter takes for motion.

A drone of 132 g that 0.4 N pull believes it moves against the pull at 6 cm/s: 5 to 7, by the time
from predictions to frames."""

EXPONENT = 0.6
"""Power of the stiffness by which drones come closer: 22, 11 and 5 cm at 3.0, 10.2 and 36/s²."""


def _pair(quantity: Kind) -> Kind:
    """Return the kind of gains level and upright; one number holds for both."""
    both = one_or_each(quantity, 2, 2)

    def check(key: str, value: Any) -> Pair:
        if form_of(value) not in both.forms:
            bound, remedy = "a number, or [level, upright]", "give one or two numbers"
            raise InputError(key, value, bound, remedy)
        given = both.check(key, value)
        level, upright = given if isinstance(given, list) else (given, given)
        return level, upright

    return replace(both, check=check)


GAIN = float | Pair | None


@documented
@dataclass(frozen=True)
class Gains(Record):
    """Gains of a position loop, one number or [level, upright]; null: the controller's default.

    Raises
    ------
    InputError: a gain that is no such number.
    """

    kp: Annotated[GAIN, Key(_pair(units.STIFFNESS), "Force by offset")] = None
    kd: Annotated[GAIN, Key(_pair(units.DAMPING), "Force by velocity")] = None
    ki: Annotated[GAIN, Key(_pair(units.INTEGRAL), "Force by offset and time")] = None

    @classmethod
    def of(cls, given: object) -> Gains:
        """Return gains that are given as such, or as a mapping with their names."""
        return cls() if given is None else mapping_of(Gains).check("gains", given)


class _Stock(NamedTuple):
    """A firmware's default parameters."""

    kp: Pair  # [N/m], or [1/s²] where per mass
    kd: Pair  # [N s/m] or [1/s]
    ki: Pair  # [N/(m s)] or [1/s³]
    ki_range: Pair  # [m s], largest integral of the offset
    off: float  # [m], how far off drones were in flight, at a stiffness over mass of
    at: float  # [1/s²]
    per_mass: bool = True
    stiffest: float = math.inf  # [1/s²], largest level kp over mass that flies
    feed_forward: bool = True
    max_tilt: float = 0.5 * math.pi  # [rad]
    filtered: bool = True  # whether it flies by the Crazyflie's filter


FREE: Pair = (math.inf, math.inf)
PID_LEVEL = 9.81 * math.radians(1.0)  # [m/s²] by degree of tilt: the loop commands 25° by m/s

STOCK: Mapping[str, _Stock] = {
    "mellinger": _Stock(
        (0.40, 1.25), (0.2, 0.4), (0.05, 0.05), (2.0, 0.4), 0.22, 0.40 / 0.132, False, 36.0
    ),
    "lee": _Stock((7.0, 7.0), (4.0, 4.0), (0.0, 0.0), FREE, 0.35, 7.0, stiffest=14.0),
    "pid": _Stock(
        (51.0 * PID_LEVEL, 51.0 * PID_LEVEL),  # 2/s times 25° by m/s, and 1° by m
        (25.0 * PID_LEVEL, 25.0 * PID_LEVEL),
        (2.0 * PID_LEVEL, 51.0 / 4.0 * PID_LEVEL),  # within 25 s, and 4 s
        FREE,
        0.52,
        51.0 * PID_LEVEL,
        feed_forward=False,
        max_tilt=math.radians(20.0),
    ),
    "px4": _Stock(
        (1.71, 4.0), (1.8, 4.0), (1.71 / 4.6, 2.0), FREE, 0.22, 1.71,
        max_tilt=math.radians(45.0), filtered=False,
    ),
}  # fmt: skip
"""Default parameters by the controllers' names."""

CONTROLLERS = tuple(STOCK)
"""Names of flight controllers."""


def stiffest_gains(mass: float) -> dict[str, float]:
    """Return the stiffest gains of Mellinger's controller that fly, for a mass [kg]."""
    stiffest = STOCK["mellinger"].stiffest
    kp = float(f"{stiffest * mass:.3g}")
    return {"kp": kp, "kd": float(f"{DAMPING_RATIO * 2.0 * math.sqrt(kp * mass):.3g}"), "ki": 0.0}


@dataclass(frozen=True)
class FlightController(OneLine):
    """A drone's position loop; pairs are level and upright.

    Attributes
    ----------
    name: one of CONTROLLERS, or empty where the problem states numbers alone.
    kp: stiffness [N/m], infinite where the loop is rigid, and so are the others then.
    kd: damping [N s/m]
    ki: gain of the integral [N/(m s)], zero without.
    ki_limit: largest force of the integral [N], zero without, infinite if unbounded.
    feed_forward: whether streamed accelerations, and with them the cable force, are added.
    max_tilt: largest tilt that it commands [rad], π/2 if any.
    tracking: how far off its drones may fly [m], or None if unknown.
    pull_gain: force that it has to be given to hold a cable's steady force, over that force: its
        damping answers the velocity for which the Crazyflie's filter takes a level pull.
    """

    name: str
    kp: Pair
    kd: Pair
    ki: Pair
    ki_limit: Pair
    feed_forward: bool
    max_tilt: float
    tracking: float | None
    pull_gain: Pair = (1.0, 1.0)

    @classmethod
    def of(
        cls, name: str, mass: float, gains: Gains | Mapping[str, Any] | None = None
    ) -> FlightController:
        """Return a controller by its name, for a drone's mass [kg], with its default gains or some.

        Raise InputError for an unknown name, or for gains at which drones were lost.
        """
        check_choice("controller", name, CONTROLLERS)
        stock, own = STOCK[name], Gains.of(gains)
        size = mass if stock.per_mass else 1.0

        def gain(key: str) -> Pair:
            given = getattr(own, key)
            level, upright = getattr(stock, key)
            return (size * level, size * upright) if given is None else given

        kp, kd, ki = gain("kp"), gain("kd"), gain("ki")
        if own.kp is not None and kp[0] > 1.01 * stock.stiffest * mass:
            most = f"{stock.stiffest:g}/s² times the mass, {stock.stiffest * mass:.3g} N/m"
            remedy = f"stiffer loops of {name} oscillate"
            raise InputError("gains.kp", kp[0], f"at most {most}, level", remedy)
        level, upright = ((k * r if k else 0.0) for k, r in zip(ki, stock.ki_range, strict=True))
        off = stock.off * (stock.at * mass / kp[0]) ** EXPONENT
        return cls(
            name, kp, kd, ki, (level, upright), stock.feed_forward, stock.max_tilt,
            tracking=max(off, RETUNED),
            pull_gain=(1.0 + PULL_TIME * kd[0] / mass if stock.filtered else 1.0, 1.0),
        )  # fmt: skip

    @classmethod
    def plain(
        cls, mass: float, stiffness: float | None, *, integral: bool, feed_forward: bool
    ) -> FlightController:
        """Return a loop of which a stiffness [N/m] is known, alike on all axes; None is rigid."""
        k = math.inf if stiffness is None else stiffness
        c, i, most = 2.0 * DAMPING_RATIO * math.sqrt(k * mass), 0.0, 0.0
        if integral:
            i, most = k / INTEGRAL_TIME, math.inf
        return cls(
            "", (k, k), (c, c), (i, i), (most, most), feed_forward, 0.5 * math.pi, tracking=None
        )  # fmt: skip
