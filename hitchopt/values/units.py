"""Physical quantities: ranges of values, and warnings of values in a wrong unit."""

from __future__ import annotations

import dataclasses
import math
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchopt.errors import InputError, UnitWarning
from hitchopt.values import MAX_COORDINATE, SCALAR, finite
from hitchopt.values.fields import Kind

SKIPPED_FILES = (
    str(Path(__file__).parents[1]),
    str(Path(dataclasses.__file__).with_suffix("")),
    "<string",
)
"""Prefixes of the names of files between a user's line and the check of a value: of this package,
and of dataclasses with the methods that it generates. A whole name does not match itself."""

RECORD_DEPTH = 7
"""Depth of the stack from ``warn_of_unit`` to the line that makes a record: between them are
``check``, ``store``, ``__post_init__``, ``__init__`` and the function that suggests keywords."""

Range = tuple[float, float]

TINY = 1e-9  # Smallest quantity in SI units by default; smaller ones are typing errors
HUGE = 1e9  # Largest quantity in SI units by default; larger ones are typing errors


def quantity(
    unit: str,
    usual: Range,
    allowed: Range = (TINY, HUGE),
    others: tuple[tuple[str, float], ...] = (),
    below: float = math.inf,
    typical: float | None = None,
) -> Kind:
    """Return the kind of a physical quantity.

    Parameters
    ----------
    unit: expected unit; the kind of an angle in radians also has one in degrees.
    usual: range outside of which a warning is issued.
    allowed: range outside of which a value is refused.
    others: other units, with their sizes in the expected unit.
    below: exclusive upper bound, in addition to the range.
    typical: value by which another unit is guessed; by default the middle of the usual range.
    """
    (low, high), (minimum, maximum) = usual, allowed

    def likely(number: float) -> OtherUnit | None:
        """Return the most plausible other unit of a value, if there is one."""
        plausible = [OtherUnit(*each) for each in others if low <= number * each[1] <= high]
        if not plausible or not number:
            return None
        middle = math.sqrt(max(low, 1e-3) * min(high, 1e3)) if typical is None else typical
        return likely_unit(number, plausible, middle)

    def remedy(number: float, fallback: str = "") -> str:
        """Return a remedy: the value in the most plausible other unit, or the fallback."""
        if meant := likely(number):
            return meant.remedy(number)
        return fallback or (f"convert it to {unit}" if unit else "use a plain number")

    def check(key: str, value: object) -> float:
        number = finite(key, value)
        if number <= 0.0 < minimum:
            raise InputError(key, value, "greater than 0", "use a positive number")
        if number < 0.0 == minimum:
            raise InputError(key, value, "at least 0", "use zero or a positive number")
        if number >= below:
            bound = f"below {below:.4g} {unit}"
            raise InputError(key, value, bound, remedy(number, "use a smaller angle"))
        if not minimum <= number <= maximum:
            bound = f"from {minimum:g} to {maximum:g} {unit}".strip()
            raise InputError(key, value, bound, remedy(number))
        if not low <= number <= high:
            words = f"{number:g} {unit}; usual values are {low:.3g} to {high:.3g} {unit}"
            meant = likely(number)
            factor = None if meant is None else meant.size
            warn_of_unit(UnitWarning(key, f"{words}; {remedy(number)}", factor))
        return number

    schema = {"type": "number", "minimum": minimum, "maximum": maximum}
    if below <= maximum:
        schema |= {"exclusiveMaximum": below}
    degrees = None
    if unit.startswith("rad"):
        ranges = [tuple(round(math.degrees(x), 9) for x in each) for each in (usual, allowed)]
        radians = [(f"radians{name.removeprefix('degrees')}", 1.0 / DEGREE) for name, _ in others]
        in_degrees = unit.replace("rad", "°"), *ranges, tuple(radians), math.degrees(below)
        degrees = quantity(*in_degrees)  # type: ignore[arg-type]
    return Kind((SCALAR,), check, schema, unit, degrees)


class OtherUnit(NamedTuple):
    """A unit that may have been meant."""

    name: str
    size: float  # of one, in the expected unit

    def remedy(self, number: float) -> str:
        """Return a remedy: the value of a number in this unit."""
        return f"if {self.name} were meant, {number * self.size:.3g}"


def likely_unit(number: float, units: Sequence[OtherUnit], typical: float) -> OtherUnit:
    """Return the unit in which a number is closest to a typical value."""
    return min(units, key=lambda unit: abs(math.log(abs(number * unit.size) / typical)))


def within_usual(kind: Kind, usual: float, typical: float) -> Kind:
    """Return a kind of points [m] that warns of coordinates beyond ±``usual`` [m].

    ``typical`` is a coordinate by which another unit is guessed.
    """

    def check(key: str, value: Any) -> Any:
        checked = kind.check(key, value)
        largest = float(np.max(np.abs(checked), initial=0.0)) if np.ndim(checked) else 0.0
        if largest > usual:
            units = [OtherUnit(*each) for each in LENGTHS if largest * each[1] <= usual]
            words = f"{largest:g} m; usual coordinates are within ±{usual:g} m"
            meant = likely_unit(largest, units, typical)
            warn_of_unit(UnitWarning(key, f"{words}; {meant.remedy(largest)}", meant.size))
        return checked

    return replace(kind, check=check)


def deviation(largest: float) -> Kind:
    """Return the kind of relative errors; larger numbers are probably percentages."""
    return quantity("", (0.0, largest), (0.0, largest), (("per cent", 1e-2),))


DEGREE = math.pi / 180.0  # One degree [rad]
MAX_WALL = 1e5  # [m] Largest coordinate of an arena's walls, which may be far away

LENGTHS = (("millimetres", 1e-3), ("centimetres", 1e-2))
GRAMS = (("grams", 1e-3),)
GRAMS_OF_FORCE = (("grams of force", 0.00981),)
UNBOUNDED = (-math.inf, math.inf)

NUMBER = quantity("", UNBOUNDED, (-HUGE, HUGE))
POSITIVE = quantity("", UNBOUNDED)

CABLE_LENGTH = quantity("m", (0.05, 30.0), (1e-3, 1e4), LENGTHS)
MASS = quantity("kg", (0.005, 100.0), (1e-5, 1e4), GRAMS)
LOAD = quantity("kg", (0.0, 100.0), (0.0, 1e4), GRAMS)
THRUST = quantity("N", (0.05, 5e3), (1e-4, 1e6), GRAMS_OF_FORCE)
TENSION = quantity("N", (0.002, 500.0), (1e-6, 1e6), GRAMS_OF_FORCE)
DENSITY = quantity("kg/m", (0.0, 1.0), (0.0, 100.0), (("grams per metre", 1e-3),))
LIGHT_DENSITY = quantity("kg/m", (0.0, 1.0), (TINY, 100.0), (("grams per metre", 1e-3),))
FRICTION = quantity("", (0.0, 3.0), (0.0, 1e9), (("per cent", 1e-2),))
STIFFNESS = quantity("N/m", (0.01, 1e5), (1e-6, 1e9), (("N/mm", 1e3),))
FORCE = quantity("N", (0.0, 500.0), (0.0, 1e6), GRAMS_OF_FORCE)
AXIAL_FORCE = quantity("N", UNBOUNDED)
DRAG = quantity("N s/m", (0.0, 10.0), (0.0, 1e3))
DAMPING = quantity("N s/m", UNBOUNDED)
INTEGRAL = quantity("N/(m s)", UNBOUNDED, (0.0, HUGE))
SPEED = quantity("m/s", (1e-3, 100.0), (TINY, 1e5), (("mm/s", 1e-3), ("cm/s", 1e-2)))
ACCELERATION = quantity("m/s²", (1e-3, 200.0), (TINY, 1e6), (("mm/s²", 1e-3), ("cm/s²", 1e-2)))
JERK = quantity("m/s³", (1e-3, 1e4), (TINY, 1e9), (("mm/s³", 1e-3), ("cm/s³", 1e-2)))
SPEED_OR_ZERO = quantity("m/s", (0.0, 100.0), (0.0, 1e5), (("mm/s", 1e-3), ("cm/s", 1e-2)))
LEG = quantity("m", (1e-3, 5.0), (TINY, 1e4), LENGTHS)
ELLIPSOID = quantity("m", (0.01, 5.0), (TINY, 1e4), LENGTHS)
DISTANCE = quantity("m", (0.0, 2.0), (0.0, 1e4), LENGTHS)
OBJECT_RADIUS = quantity("m", (1e-3, 10.0), (TINY, HUGE), LENGTHS, typical=0.2)
OBJECT_HEIGHT = quantity("m", (-20.0, 20.0), (-HUGE, HUGE), LENGTHS, typical=0.3)
OBJECT_MASS = quantity("kg", (1e-4, 20.0), (TINY, HUGE), GRAMS)
VERTEX_ERROR = quantity("m", (1e-3, 2.0), (TINY, 1e4), LENGTHS, typical=0.1)
LENGTH_ERROR = quantity("m", (0.0, 0.5), (0.0, 1e4), LENGTHS, typical=0.01)
TRACKING_ERROR = quantity("m", (0.0, 2.0), (0.0, 1e4), LENGTHS, typical=0.05)
USUAL_OUTLINE = 30.0  # [m] Largest usual coordinate of a polygon of clasps, or of an object
LENGTH = quantity("m", (1e-3, 10.0), (TINY, HUGE), LENGTHS, typical=0.3)
LENGTH_OR_ZERO = quantity("m", (0.0, 10.0), (0.0, HUGE), LENGTHS, typical=0.3)
NEAR = (-MAX_COORDINATE, MAX_COORDINATE)
ALTITUDE = quantity("m", (-50.0, 50.0), NEAR, LENGTHS, typical=1.5)
PLACED_ALTITUDE = quantity("m", NEAR, NEAR, LENGTHS)
WALL = quantity("m", (-2e3, 2e3), (-MAX_WALL, MAX_WALL), LENGTHS)
COORDINATE = quantity("m", UNBOUNDED, (-HUGE, HUGE))
DURATION = quantity("s", (1e-3, 1e5), (TINY, 1e9), (("milliseconds", 1e-3),))
START_TIME = quantity("s", (0.0, 1e5), (0.0, 1e9), (("milliseconds", 1e-3),))
LATENCY = quantity("s", (1e-3, 1.0), (0.0, 10.0), (("milliseconds", 1e-3),))
DELAY = quantity("s", (0.0, 1.0), (0.0, 10.0), (("milliseconds", 1e-3),))
SHARE = quantity("", UNBOUNDED, (TINY, 1.0))
THRUST_FACTOR = quantity("", (0.5, 2.0), (0.1, 10.0), (("per cent", 1e-2),))
RIGHT_ANGLE = 0.5 * math.pi
TILT = quantity(
    "rad", (1.1 * DEGREE, RIGHT_ANGLE), (TINY, RIGHT_ANGLE), (("degrees", DEGREE),), RIGHT_ANGLE
)
SWING = quantity("rad", UNBOUNDED, (0.0, RIGHT_ANGLE), (("degrees", DEGREE),), RIGHT_ANGLE)
ROLL = quantity("rad", UNBOUNDED, (-RIGHT_ANGLE, RIGHT_ANGLE), (), RIGHT_ANGLE)
BODY_RATE = quantity("rad/s", (0.17, 70.0), (TINY, 1e6), (("degrees per second", DEGREE),))
ANGLE = quantity("rad", UNBOUNDED, (-HUGE, HUGE))

MIN_LIFT = 0.01  # Smallest ratio of thrust to weight; below it one of the two is in a wrong unit
MAX_LIFT = 100.0  # Largest ratio of thrust to weight; above it one of the two is in a wrong unit


def check_lift(mass: float, max_thrust: float, gravity: float) -> None:
    """Raise InputError unless a drone's thrust [N] exceeds its weight, by a plausible factor.

    Where thrust and weight (mass [kg]) differ by a factor of a hundred, one of them is in a wrong
    unit: the mass, if grams fit, else the thrust.
    """
    lift = max_thrust / (mass * gravity)
    weight = f"{mass:g} kg weigh {mass * gravity:.3g} N"
    if 1.0 < lift < MAX_LIFT:
        return
    if MIN_LIFT < lift <= 1.0:
        bound = f"above the drone's weight ({weight}), or it cannot hover"
        remedy = "state the thrust of all motors, a smaller mass, or a drone with more thrust"
        raise InputError("max_thrust", max_thrust, bound, remedy)
    if 1.0 < 1e3 * lift < MAX_LIFT:
        bound = (
            f"in kg, its weight within a factor of 100 of max_thrust {max_thrust:g} N ({weight})"
        )
        raise InputError("mass", mass, bound, f"if grams were meant, {1e-3 * mass:g}")
    bound = f"in N, within a factor of 100 of the weight ({weight})"
    grams = GRAMS_OF_FORCE[0][1] * max_thrust
    remedy = f"if grams of force were meant, {grams:.3g}" if lift > 1.0 else "convert it to N"
    raise InputError("max_thrust", max_thrust, bound, remedy)


def warn_of_unit(warning: UnitWarning) -> None:
    """Issue the warning at the line that passed the value to this package.

    Python 3.11 finds it for records that check their fields by ``store``; for others, such as lists
    in records, the line is one of this package.
    """
    if sys.version_info >= (3, 12):
        warnings.warn(warning, skip_file_prefixes=SKIPPED_FILES)
    else:
        warnings.warn(warning, stacklevel=RECORD_DEPTH)
