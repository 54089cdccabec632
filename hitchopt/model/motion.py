"""A hitch in motion: the polynomials of a plan and what they have to keep, nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Arena, Limits, Separation, Team
from hitchopt.trajectory import PiecewisePolynomial, joined


@dataclass(frozen=True)
class Phase:
    """A span of a plan's time.

    Attributes
    ----------
    name: such as ``morph`` or ``hold``.
    step: index of the mission's step that it belongs to.
    start, end: [s]
    remark: what happens that was not asked for, and why; mostly nothing.
    """

    name: str
    step: int
    start: float
    end: float
    remark: str = ""


@dataclass(frozen=True, eq=False)
class Motion:
    """Where drones, vertices, legs and tensions are at every time, and within which limits.

    Parameters
    ----------
    team, limits, separation, arena: who flies, and what must be kept.
    drones: of shape (2n, 3) [m], in the order q0, r0, q1, r1, ….
    vertices: of shape (points, 3) [m]: n points of a closed hitch, n + 1 of a chain.
    legs: of shape (n, 2) [m]: ``d_k``, ``e_k``; zero where a chain's end has none.
    tensions: of shape (n,) [N].
    phases: one after the other, covering all of the time.

    Raises
    ------
    InputError: shapes that do not fit the team, or breaks that are not the same for all.
    """

    team: Team
    limits: Limits
    separation: Separation
    arena: Arena | None
    drones: PiecewisePolynomial
    vertices: PiecewisePolynomial
    legs: PiecewisePolynomial
    tensions: PiecewisePolynomial
    phases: tuple[Phase, ...]

    def __post_init__(self) -> None:
        n = self.team.robots
        points = self.team.layout.points
        shapes = {"drones": (2 * n, 3), "vertices": (points, 3), "legs": (n, 2), "tensions": (n,)}
        for name, shape in shapes.items():
            part: PiecewisePolynomial = getattr(self, name)
            if part.shape != shape:
                raise InputError(name, part.shape, f"of shape {shape}", "one row per robot's parts")
            if not np.array_equal(part.breaks, self.drones.breaks):
                raise InputError(name, "its breaks", "those of the drones", "split them alike")

    @property
    def duration(self) -> float:
        """Of all phases together [s]."""
        return self.drones.duration


def joined_motions(motions: Sequence[Motion]) -> Motion:
    """Return one motion of the given ones in a row; team and limits are the first one's."""
    first = motions[0]
    phases: list[Phase] = []
    offset = 0.0
    for motion in motions:
        phases += [replace(p, start=offset + p.start, end=offset + p.end) for p in motion.phases]
        offset += motion.duration
    return Motion(
        first.team,
        first.limits,
        first.separation,
        first.arena,
        joined([m.drones for m in motions]),
        joined([m.vertices for m in motions]),
        joined([m.legs for m in motions]),
        joined([m.tensions for m in motions]),
        tuple(phases),
    )
