"""What flies: the polynomials of a plan and what they have to keep, nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import Arena, Limits, Separation, Swarm, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.hitch.keep_out import Prism
from hitchopt.model.phases import JOINT, CableState, Phase, check_phases
from hitchopt.trajectory import PiecewisePolynomial, joined

__all__ = ["JOINT", "CableState", "Flying", "Motion", "Phase", "SwarmMotion", "joined_motions"]


@dataclass(frozen=True, eq=False)
class Motion:
    """Where drones, vertices, legs and tensions are at every time, and within which limits.

    While no hitch exists, vertices, legs and tensions stand for nothing: they are kept so that one
    plan has one set of arrays, and tensions are 0.

    Parameters
    ----------
    team, limits, separation, arena: who flies, and what must be kept.
    drones: of shape (2n, 3) [m], in the order q0, r0, q1, r1, ….
    vertices: of shape (points, 3) [m]: n points of a closed hitch, n + 1 of a chain.
    legs: of shape (n, 2) [m]: ``d_k``, ``e_k``; zero where a chain's end has none.
    tensions: of shape (n,) [N].
    phases: one after the other, covering all of the time.
    assignment: which robots fly which roles, where that was chosen.
    leg_tensions: of shape (n, 2) [N], what the legs ``d_k``, ``e_k`` pull with where cables slide
        against friction; None where every leg pulls with its cable's tension.

    Raises
    ------
    InputError: shapes that do not fit the team, breaks that are not the same for all, phases that
        leave a gap or go back, or cables that change their state within a piece.
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
    assignment: Assignment | None = None
    leg_tensions: PiecewisePolynomial | None = None

    def __post_init__(self) -> None:
        n = self.team.robots
        points = self.team.layout.points
        shapes = {
            "drones": (2 * n, 3),
            "vertices": (points, 3),
            "legs": (n, 2),
            "tensions": (n,),
            "leg_tensions": (n, 2),
        }
        for name, shape in shapes.items():
            part: PiecewisePolynomial | None = getattr(self, name)
            if part is None:
                continue
            if part.shape != shape:
                raise InputError(name, part.shape, f"of shape {shape}", "one row per robot's parts")
            if not np.array_equal(part.breaks, self.drones.breaks):
                raise InputError(name, "its breaks", "those of the drones", "split them alike")
        check_phases(self.phases, float(self.drones.breaks[0]), float(self.drones.breaks[-1]))
        if any(phase.state is CableState.NONE for phase in self.phases):
            raise InputError("phases.state", "none", "a state of cables", "give what cables do")
        changes = np.array(
            [b.start for a, b in pairwise(self.phases) if a.state != b.state], dtype=np.float64
        )
        apart = np.abs(changes[:, None] - self.drones.breaks)
        if apart.size and np.max(np.min(apart, axis=1)) > JOINT:
            raise InputError(
                "phases", changes.tolist(), "breaks where states change", "split the pieces there"
            )
        if self.assignment is not None and len(self.assignment.robots) != n:
            raise InputError(
                "assignment", len(self.assignment.robots), f"{n} robots", "give one per role"
            )

    @property
    def duration(self) -> float:
        """Of all phases together [s]."""
        return self.drones.duration

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Of shape (2n,) [N]: what the cable pulls each drone with, q0, r0, q1, …."""
        if self.leg_tensions is None:
            each = np.repeat(self.tensions.coefficients, 2, axis=1)
        else:
            each = self.leg_tensions.coefficients
            each = each.reshape(len(each), -1, each.shape[-1])
        return PiecewisePolynomial(self.drones.breaks, each)

    @property
    def formed(self) -> NDArray[np.bool_]:
        """(pieces,): whether the hitch exists on each piece; it does where there are no phases."""
        if not self.phases:
            return np.ones(self.drones.pieces, dtype=np.bool_)
        here: NDArray[np.bool_] = np.array([p.formed for p in self.phases])[self.phase_of_piece]
        return here

    @property
    def phase_of_piece(self) -> NDArray[np.intp]:
        """(pieces,): index of the phase in which the middle of each piece lies."""
        middles = 0.5 * (self.drones.breaks[1:] + self.drones.breaks[:-1])
        ends = np.array([phase.end for phase in self.phases[:-1]])
        here: NDArray[np.intp] = np.searchsorted(ends, middles)
        return here

    def spans(self, *, formed: bool) -> tuple[Motion, ...]:
        """Return the longest runs of pieces on which the hitch exists, or does not.

        Each at its own times, as a motion of the phases that it overlaps.
        """
        wanted = self.formed == formed
        if np.all(wanted):
            return (self,)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]])))
        return tuple(
            self._run(slice(int(first), int(last))) for first, last in edges.reshape(-1, 2)
        )

    def _run(self, pieces: slice) -> Motion:
        breaks = self.drones.breaks[pieces.start : pieces.stop + 1]
        overlapping = tuple(
            phase
            for phase in self.phases
            if phase.end > breaks[0] + JOINT and phase.start < breaks[-1] - JOINT
        )
        return self.taken(pieces, overlapping)

    def taken(self, pieces: slice, phases: Sequence[Phase]) -> Motion:
        """Return the motion on a run of pieces, at the same times, and its phases."""
        return self.changed(lambda part: part.taken(pieces), phases)

    def changed(
        self, change: Callable[[PiecewisePolynomial], PiecewisePolynomial], phases: Sequence[Phase]
    ) -> Motion:
        """Return the motion with all of its polynomials changed alike, and other phases."""
        legs = self.leg_tensions
        return replace(
            self,
            drones=change(self.drones),
            vertices=change(self.vertices),
            legs=change(self.legs),
            tensions=change(self.tensions),
            leg_tensions=None if legs is None else change(legs),
            phases=tuple(phases),
        )


@dataclass(frozen=True, eq=False)
class SwarmMotion:
    """Where single drones are at every time, and within which limits.

    Parameters
    ----------
    team, limits, separation, arena: who flies, and what must be kept.
    drones: of shape (N, 3) [m], in the order d0, d1, ….
    phases: one after the other, covering all of the time; their state becomes ``none``.
    keep_out: prisms that the drones stay out of.

    Raises
    ------
    InputError: a shape that does not fit the team, or phases that leave a gap or go back.
    """

    team: Swarm
    limits: Limits
    separation: Separation
    arena: Arena | None
    drones: PiecewisePolynomial
    phases: tuple[Phase, ...]
    keep_out: tuple[Prism, ...] = ()

    def __post_init__(self) -> None:
        shape = (self.team.drones, 3)
        if self.drones.shape != shape:
            raise InputError("drones", self.drones.shape, f"of shape {shape}", "one row per drone")
        check_phases(self.phases, float(self.drones.breaks[0]), float(self.drones.breaks[-1]))
        none = tuple(replace(phase, state=CableState.NONE) for phase in self.phases)
        object.__setattr__(self, "phases", none)

    @property
    def duration(self) -> float:
        """Of all phases together [s]."""
        return self.drones.duration


Flying = Motion | SwarmMotion
"""Whatever has drones on polynomials of time."""


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
        first.assignment,
        _joined_leg_tensions(motions),
    )


def _joined_leg_tensions(motions: Sequence[Motion]) -> PiecewisePolynomial | None:
    if all(motion.leg_tensions is None for motion in motions):
        return None
    both = joined([motion.pulls for motion in motions])
    c = both.coefficients
    return PiecewisePolynomial(both.breaks, c.reshape(len(c), -1, 2, c.shape[-1]))
