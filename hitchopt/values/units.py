"""Values probably given in another unit: usual and possible ranges, and suggested units."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from types import FrameType
from typing import Any, NamedTuple

from hitchopt.errors import InputError, UnitWarning
from hitchopt.values import acute, not_negative, positive

OUTSIDE = frozenset({"hitchopt", "contextlib", "dataclasses"})
"""Packages between a user's line and the place where a value is checked."""


class Quantity(NamedTuple):
    """A physical quantity."""

    unit: str  # the one expected
    usual: tuple[float, float]  # range outside of which a warning is issued
    possible: tuple[float, float]  # range outside of which a value is refused
    others: tuple[tuple[str, float], ...] = ()  # other units, and their sizes in the one expected


LENGTHS = (("millimetres", 1e-3), ("centimetres", 1e-2))
GRAMS = (("grams", 1e-3),)
GRAMS_OF_FORCE = (("grams of force", 0.00981),)
DEGREES = 0.017453292519943295
"""One degree [rad]."""

CABLE_LENGTH = Quantity("m", (0.05, 100.0), (1e-3, 1e4), LENGTHS)
MASS = Quantity("kg", (0.005, 100.0), (1e-5, 1e4), GRAMS)
LOAD = Quantity("kg", (0.0, 100.0), (0.0, 1e4), GRAMS)
THRUST = Quantity("N", (0.05, 5e3), (1e-4, 1e6), GRAMS_OF_FORCE)
TENSION = Quantity("N", (0.002, 500.0), (1e-6, 1e6), GRAMS_OF_FORCE)
DENSITY = Quantity("kg/m", (0.0, 1.0), (0.0, 100.0), (("grams per metre", 1e-3),))
FRICTION = Quantity("(a coefficient)", (0.0, 3.0), (0.0, 1e9), (("per cent", 1e-2),))
STIFFNESS = Quantity("N/m", (0.01, 1e5), (1e-6, 1e9), (("N/mm", 1e3),))
SPEED = Quantity("m/s", (1e-3, 100.0), (0.0, 1e5), (("mm/s", 1e-3), ("cm/s", 1e-2)))
ACCELERATION = Quantity("m/s²", (1e-3, 200.0), (0.0, 1e6), (("mm/s²", 1e-3), ("cm/s²", 1e-2)))
JERK = Quantity("m/s³", (1e-3, 1e4), (0.0, 1e9), (("mm/s³", 1e-3), ("cm/s³", 1e-2)))
LEG = Quantity("m", (1e-3, 20.0), (0.0, 1e4), LENGTHS)
ELLIPSOID = Quantity("m", (0.01, 10.0), (0.0, 1e4), LENGTHS)
DISTANCE = Quantity("m", (0.0, 10.0), (0.0, 1e4), LENGTHS)
HEIGHT = Quantity("m", (-2e3, 2e3), (-1e5, 1e5), LENGTHS)
DURATION = Quantity("s", (1e-3, 1e5), (0.0, 1e9), (("milliseconds", 1e-3),))
TILT = Quantity("rad", (0.02, 1.6), (0.0, 1.6), (("degrees", DEGREES),))
TILT_DEG = Quantity("°", (1.1, 90.0), (0.0, 90.0), (("radians", 1.0 / DEGREES),))
BODY_RATE = Quantity("rad/s", (0.05, 70.0), (0.0, 1e6), (("degrees per second", DEGREES),))
BODY_RATE_DEG = Quantity("°/s", (10.0, 4e3), (0.0, 1e8), (("radians per second", 1.0 / DEGREES),))

MIN_LIFT, MAX_LIFT = 0.01, 100.0
"""Range of thrust over weight outside of which one of the two is in another unit."""


def check_unit(key: str, value: Any, quantity: Quantity) -> None:
    """Refuse, or warn of, a value (or the first of an array) probably in another unit."""
    values = [value] if isinstance(value, float) else value.ravel().tolist()
    (low, high), (least, most) = quantity.usual, quantity.possible
    for i, number in enumerate(values):
        name, meant = (
            key if len(set(values)) == 1 else f"{key}[{i}]",
            _unit_remedy(number, quantity),
        )
        if not least <= number <= most:
            bound = f"from {least:g} to {most:g} {quantity.unit}"
            raise InputError(name, number, bound, meant)
        if not low <= number <= high:
            usual = f"usual are {low:g} to {high:g} {quantity.unit}"
            warn_of_unit(UnitWarning(name, f"{number:g} {quantity.unit}; {usual}; {meant}"))
            return


FIELDS: Mapping[str, tuple[Callable[[str, Any], Any], Quantity]] = {
    "mass": (positive, MASS),
    "max_thrust": (positive, THRUST),
    "stiffness": (positive, STIFFNESS),
    "cable_density": (not_negative, DENSITY),
    "cable_friction": (not_negative, FRICTION),
    "speed": (positive, SPEED),
    "acceleration": (positive, ACCELERATION),
    "jerk": (positive, JERK),
    "tilt": (acute, TILT),
    "vertex_speed": (positive, SPEED),
    "leg": (positive, LEG),
    "duration": (positive, DURATION),
    "body_rate": (positive, BODY_RATE),
    "tracking": (not_negative, DISTANCE),
    "radius": (positive, ELLIPSOID),
    "height": (positive, ELLIPSOID),
    "cable": (not_negative, DISTANCE),
    "crossing": (not_negative, DISTANCE),
    "object": (not_negative, DISTANCE),
}
"""Checks and quantities of the fields of teams and requirements."""


def store(record: object, values: Mapping[str, Any], checked: Collection[str] = ()) -> None:
    """Set fields of a frozen record; those of FIELDS to the results of their checks.

    None is accepted if it is the field's default. Units of ``checked`` fields were checked before.
    """
    for name, value in values.items():
        number = value
        if name in FIELDS and (value is not None or getattr(type(record), name, "") is not None):
            check, quantity = FIELDS[name]
            number = check(name, value)
            if name not in checked:
                check_unit(name, number, quantity)
        object.__setattr__(record, name, number)


def radians_of(
    key: str, radians: float | None, degrees: float | None, quantity: Quantity
) -> float | None:
    """Return an angle or a rate in radians, given in radians or in degrees but not in both."""
    if degrees is None:
        return None if radians is None else positive(key, radians)
    name = f"{key}_deg"
    if radians is not None:
        raise InputError(name, degrees, f"left out where {key} is given", "give one of the two")
    number = positive(name, degrees)
    if key == "tilt" and number >= 90.0:
        raise InputError(name, degrees, "below 90°", "give a smaller angle")
    check_unit(name, number, quantity)
    return number * DEGREES


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
    raise InputError("max_thrust", max_thrust, bound, _unit_remedy(max_thrust, THRUST))


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


@contextmanager
def keys_within(parent: str) -> Iterator[None]:
    """Prefix the keys of errors and warnings with that of the enclosing mapping ``parent``."""
    with warnings.catch_warnings(record=True) as caught:
        try:
            yield
        except (InputError, UnitWarning) as error:  # a warning where filters make it an error
            raise error.within(parent) from None
    for each in caught:
        if isinstance(each.message, UnitWarning):
            warn_of_unit(each.message.within(parent))
        else:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)


def _unit_remedy(number: float, quantity: Quantity) -> str:
    """Return a remedy: the value in the first other unit that makes it usual, or the unit."""
    low, high = quantity.usual
    for name, size in quantity.others:
        if low <= number * size <= high and number:
            return f"if {name} were meant, {number * size:.3g}"
    return f"give it in {quantity.unit}"
