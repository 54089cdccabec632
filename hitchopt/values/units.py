"""Physical quantities: ranges of their values, and warnings of values given in another unit."""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import replace
from types import FrameType

from hitchopt.errors import InputError, UnitWarning
from hitchopt.values import ONE, finite
from hitchopt.values.fields import Kind

OUTSIDE = frozenset({"hitchopt", "contextlib", "dataclasses"})
"""Packages between a user's line and the place where a value is checked."""

Range = tuple[float, float]

LEAST, MOST = 1e-9, 1e9
"""Smallest and largest quantity in SI units that is not a typing error, if it is not bounded."""


def quantity(
    unit: str,
    usual: Range,
    possible: Range = (LEAST, MOST),
    others: tuple[tuple[str, float], ...] = (),
    below: float = math.inf,
) -> Kind:
    """Return the kind of a physical quantity.

    Parameters
    ----------
    unit: expected unit; of angles in radians the kind has one in degrees, too.
    usual: range outside of which a warning is issued.
    possible: range outside of which a value is refused.
    others: other units, and their sizes in the one expected.
    below: exclusive upper bound, besides the range.
    """
    (low, high), (least, most) = usual, possible

    def meant(number: float, otherwise: str = "") -> str:
        """Return a remedy: the value in the other unit that makes it most usual, or another."""
        fitting = [(name, number * size) for name, size in others if low <= number * size <= high]
        if fitting and number:
            middle = math.sqrt(max(low, 1e-3) * min(high, 1e3))
            name, value = min(fitting, key=lambda each: abs(math.log(abs(each[1]) / middle)))
            return f"if {name} were meant, {value:.3g}"
        return otherwise or (f"give it in {unit}" if unit else "give a plain number")

    def check(key: str, value: object) -> float:
        number = finite(key, value)
        if number <= 0.0 < least:
            raise InputError(key, value, "greater than 0", "give a positive number")
        if number < 0.0 == least:
            raise InputError(key, value, "at least 0", "give zero or a positive number")
        if number >= below:
            bound, remedy = f"below {below:.4g} {unit}", meant(number, "give a smaller angle")
            raise InputError(key, value, bound, remedy)
        if not least <= number <= most:
            bound = f"from {least:g} to {most:g} {unit}".strip()
            raise InputError(key, value, bound, meant(number))
        if not low <= number <= high:
            words = f"{number:g} {unit}; usual are {low:.3g} to {high:.3g} {unit}"
            warn_of_unit(UnitWarning(key, f"{words}; {meant(number)}"))
        return number

    schema = {"type": "number", "minimum": least, "maximum": most}
    if below <= most:
        schema |= {"exclusiveMaximum": below}
    degrees = None
    if unit.startswith("rad"):
        ranges = [tuple(round(math.degrees(x), 9) for x in each) for each in (usual, possible)]
        other = [(f"radians{name.removeprefix('degrees')}", 1.0 / DEGREE) for name, _ in others]
        in_degrees = unit.replace("rad", "°"), *ranges, tuple(other), math.degrees(below)
        degrees = quantity(*in_degrees)  # type: ignore[arg-type]
    return Kind((ONE,), check, schema, unit, degrees)


DEGREE = math.pi / 180.0
"""One degree [rad]."""

LENGTHS = (("millimetres", 1e-3), ("centimetres", 1e-2))
GRAMS = (("grams", 1e-3),)
GRAMS_OF_FORCE = (("grams of force", 0.00981),)
ANY = (-math.inf, math.inf)  # nothing is unusual

NUMBER = quantity("", ANY, (-MOST, MOST))
POSITIVE = quantity("", ANY)
NOT_NEGATIVE = quantity("", ANY, (0.0, MOST))

CABLE_LENGTH = quantity("m", (0.05, 100.0), (1e-3, 1e4), LENGTHS)
MASS = quantity("kg", (0.005, 100.0), (1e-5, 1e4), GRAMS)
LOAD = quantity("kg", (0.0, 100.0), (0.0, 1e4), GRAMS)
THRUST = quantity("N", (0.05, 5e3), (1e-4, 1e6), GRAMS_OF_FORCE)
TENSION = quantity("N", (0.002, 500.0), (1e-6, 1e6), GRAMS_OF_FORCE)
DENSITY = quantity("kg/m", (0.0, 1.0), (0.0, 100.0), (("grams per metre", 1e-3),))
FRICTION = quantity("", (0.0, 3.0), (0.0, 1e9), (("per cent", 1e-2),))
STIFFNESS = quantity("N/m", (0.01, 1e5), (1e-6, 1e9), (("N/mm", 1e3),))
DAMPING = quantity("N s/m", ANY)
INTEGRAL = quantity("N/(m s)", ANY, (0.0, MOST))
SPEED = quantity("m/s", (1e-3, 100.0), (LEAST, 1e5), (("mm/s", 1e-3), ("cm/s", 1e-2)))
ACCELERATION = quantity("m/s²", (1e-3, 200.0), (LEAST, 1e6), (("mm/s²", 1e-3), ("cm/s²", 1e-2)))
JERK = quantity("m/s³", (1e-3, 1e4), (LEAST, 1e9), (("mm/s³", 1e-3), ("cm/s³", 1e-2)))
LEG = quantity("m", (1e-3, 20.0), (LEAST, 1e4), LENGTHS)
ELLIPSOID = quantity("m", (0.01, 10.0), (LEAST, 1e4), LENGTHS)
DISTANCE = quantity("m", (0.0, 10.0), (0.0, 1e4), LENGTHS)
LENGTH = quantity("m", ANY)
LENGTH_OR_ZERO = quantity("m", ANY, (0.0, MOST))
HEIGHT = quantity("m", (-2e3, 2e3), (-1e5, 1e5), LENGTHS)
COORDINATE = quantity("m", ANY, (-MOST, MOST))
DURATION = quantity("s", (1e-3, 1e5), (LEAST, 1e9), (("milliseconds", 1e-3),))
START_TIME = quantity("s", (0.0, 1e5), (0.0, 1e9), (("milliseconds", 1e-3),))
SHARE = quantity("", ANY, (LEAST, 1.0))
RIGHT_ANGLE = 0.5 * math.pi
TILT = quantity(
    "rad", (1.1 * DEGREE, RIGHT_ANGLE), (LEAST, RIGHT_ANGLE), (("degrees", DEGREE),), RIGHT_ANGLE
)
SWING = quantity("rad", ANY, (0.0, RIGHT_ANGLE), (("degrees", DEGREE),), RIGHT_ANGLE)
ROLL = quantity("rad", ANY, (-RIGHT_ANGLE, RIGHT_ANGLE), (), RIGHT_ANGLE)
BODY_RATE = quantity("rad/s", (0.17, 70.0), (LEAST, 1e6), (("degrees per second", DEGREE),))
ANGLE = quantity("rad", ANY, (-MOST, MOST))

MIN_LIFT, MAX_LIFT = 0.01, 100.0
"""Range of thrust over weight outside of which one of the two is in another unit."""


def check_lift(mass: float, max_thrust: float, gravity: float) -> None:
    """Raise InputError for a thrust [N] that is a hundred times off a drone's weight (mass in kg).

    It blames the mass if grams fit, else the thrust.
    """
    lift = max_thrust / (mass * gravity)
    if MIN_LIFT < lift < MAX_LIFT:
        return
    weight = f"{mass:g} kg weigh {mass * gravity:.3g} N"
    if 1.0 < 1e3 * lift < MAX_LIFT:
        bound = f"in kg, its weight within 100 times of max_thrust {max_thrust:g} N ({weight})"
        raise InputError("mass", mass, bound, f"if grams were meant, {1e-3 * mass:g}")
    bound = f"in N, within 100 times of the weight ({weight})"
    grams = GRAMS_OF_FORCE[0][1] * max_thrust
    remedy = f"if grams of force were meant, {grams:.3g}" if lift > 1.0 else "give it in N"
    raise InputError("max_thrust", max_thrust, bound, remedy)


def warn_of_unit(warning: UnitWarning) -> None:
    """Issue the warning at the user's line that passed the value; copies of records issue none."""
    level, frame = 1, sys._getframe(0)
    copied = False
    while frame.f_back and (package := _package(frame)) in OUTSIDE:
        if copied and package == "hitchopt":
            return
        copied = frame.f_code is replace.__code__
        level, frame = level + 1, frame.f_back
    warnings.warn(warning, stacklevel=level)


def _package(frame: FrameType) -> str:
    name: str = frame.f_globals.get("__name__", "")
    return name.partition(".")[0]
