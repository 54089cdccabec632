"""Objects: upright rigid bodies with a section, a height, a weight and perhaps a rim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError, OneLine
from hitchopt.objects.section import Section
from hitchopt.objects.slab import Slab
from hitchopt.values import Array, as_array, coordinate, finite, instance, not_negative, positive


@dataclass(frozen=True, eq=False)
class Rim(OneLine):
    """A thin rim or tray of an object, which may rest on cables.

    Parameters
    ----------
    section: its outline, about the object's origin.
    height: of it above the object's base [m].
    """

    section: Section
    height: float

    def __post_init__(self) -> None:
        instance("section", self.section, Section)
        object.__setattr__(self, "height", coordinate("height", self.height))


@dataclass(frozen=True, eq=False)
class SolidObject(OneLine):
    """An upright rigid object; its mass is spread evenly between its two heights.

    Parameters
    ----------
    section: of its body, about its own origin.
    lower, upper: heights of the body's floor and ceiling above its base [m]
    mass: [kg]
    friction: coefficient between it and cables, and what it stands on.
    at: (3,) [m], where the origin of its base stands.
    yaw: by how much it is turned there, counter-clockwise [rad].
    rim: its rim, or None. That of a flat tray is its underside.
    fixed: whether it never moves, as tables do; a fixed one may stand on anything or nothing.

    Raises
    ------
    InputError: a number out of its range, or a rim off the body.
    """

    section: Section
    lower: float
    upper: float
    mass: float
    friction: float
    at: Array
    yaw: float = 0.0
    rim: Rim | None = None
    fixed: bool = False

    def __init__(
        self,
        section: Section,
        lower: float = 0.0,
        upper: float = 0.3,
        mass: float = 0.1,
        friction: float = 0.5,
        at: ArrayLike = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
        rim: Rim | None = None,
        fixed: bool = False,
    ) -> None:
        instance("section", section, Section)
        if rim is not None:
            instance("rim", rim, Rim)
        given = as_array(at)
        if given.shape != (3,):
            raise InputError("at", at, "a point [x, y, z]", "give three numbers in metres")
        place = np.array([coordinate(f"at[{i}]", x) for i, x in enumerate(given.tolist())])
        place.setflags(write=False)
        if not isinstance(fixed, bool):
            raise InputError("fixed", fixed, "true or false", "write fixed: true of a table")
        values = {
            "section": section,
            "lower": coordinate("lower", lower),
            "upper": coordinate("upper", upper),
            "mass": positive("mass", mass),
            "friction": not_negative("friction", friction),
            "at": place,
            "yaw": finite("yaw", yaw),
            "rim": rim,
            "fixed": fixed,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.lower >= self.upper:
            bound, remedy = f"above its floor, {self.lower:g} m", "exchange the heights"
            raise InputError("upper", self.upper, bound, remedy)
        if rim is not None and not self.lower <= rim.height <= self.upper:
            bound = f"from the body's floor, {self.lower:g} m, to its ceiling, {self.upper:g} m"
            raise InputError("rim.height", rim.height, bound, "put the rim on the body")
        if rim is not None and rim.section.clearance(section.centroid)[0] >= 0.0:
            bound = f"around the body's centre, {section.centroid.tolist()}"
            raise InputError("rim.section", rim.section, bound, "put the rim on the body")

    @property
    def slabs(self) -> tuple[Slab, ...]:
        """Its convex parts in its own frame: the body, and the rim as thin as a sheet."""
        body = Slab(self.section, self.lower, self.upper)
        if self.rim is None:
            return (body,)
        return body, Slab(self.rim.section, self.rim.height, self.rim.height)

    @property
    def stem(self) -> Section | None:
        """What the clasps below its rim are around: its body, or nothing of a flat tray."""
        flat = self.rim is not None and self.rim.height == self.lower
        return None if flat else self.section

    @property
    def centre_of_mass(self) -> Array:
        """Point (3,) [m], seen from its base: centroid of the section, half of the height."""
        return np.append(self.section.centroid, 0.5 * (self.lower + self.upper))

    @property
    def pose(self) -> Array:
        """(5,): where it stands at first, x, y, z [m] of its base, and cosine and sine of yaw."""
        return np.array([*self.at, np.cos(self.yaw), np.sin(self.yaw)])

    @property
    def circumradius(self) -> float:
        """Radius [m] of a circle about its origin that holds body and rim, seen from above."""
        return max(slab.section.circumradius for slab in self.slabs)
