"""Motion of a team: the polynomials of a plan, its phases and its requirements."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError, OneLine, StepPlace
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.cable_state import CableState, StateTest
from hitchopt.objects.placing import poses_of
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.values import check_instance, counted, lazy, sequence, true_runs

JOINT = 1e-6
"""[s] Largest gap between phases, and between a change of the cables' state and a break."""

WAIT = "wait"  # Name of phases in which a team waits at rest while others fly
TAKE_OFF = "take-off"  # Name of phases in which tying begins, up from the ground

SETTLE = "settle"
"""Name of phases at the ends of steps in which vertices over-travel against friction."""


class HoldBy(StrEnum):
    """Kind of hold: the object's rim rests on the clasps, or cables grip its section."""

    REST = "rest"
    GRIP = "grip"


@dataclass(frozen=True)
class PhaseHold:
    """An object that a hitch holds in a phase: its name, the kind of hold, and the holding cables.

    These cables may touch it. The certificate verifies the hold from the polynomials.
    """

    object: str
    by: HoldBy
    cables: tuple[int, ...]


@dataclass(frozen=True)
class Phase(OneLine):
    """A time span of a plan.

    Attributes
    ----------
    name: a label, such as ``morph`` or ``hold``. Nothing moves in a phase named WAIT, and vertices
        are where they were after one named SETTLE, which follows a slide.
    step: index of its step in the mission.
    start, end: [s]
    remark: how the motion deviates from the request, and why, in words; usually empty.
    state: state of the cables.
    tension: smallest and largest tension [N] that the step allows during its motion; None for the
        team's tensions. Part of the problem: the check ``tension`` requires this range, and the
        team's tensions at both ends.
    hold: the object that the hitch holds; None without one.
    """

    name: str
    step: int
    start: float
    end: float
    remark: str = ""
    state: CableState = CableState.HITCHED
    tension: tuple[float, float] | None = None
    hold: PhaseHold | None = None

    @property
    def place(self) -> StepPlace:
        """Its step, in violations."""
        return StepPlace(self.step, self.name)

    def retimed(self, start: float, end: float) -> Phase:
        """Return the phase with another start and end [s]."""
        return Phase(**(vars(self) | {"start": start, "end": end}))


def check_phases(phases: Sequence[Phase], start: float, end: float) -> None:
    """Raise InputError unless phases are contiguous and cover the time from start to end [s].

    They may begin earlier and end later: a part of a motion has all phases that it overlaps.
    """
    spans = [[phase.start, phase.end] for phase in phases]
    covered = not spans or (spans[0][0] <= start + JOINT and spans[-1][1] >= end - JOINT)
    contiguous = all(abs(later[0] - earlier[1]) <= JOINT for earlier, later in pairwise(spans))
    ascending = all(first < last for first, last in spans)
    if not (covered and contiguous and ascending):
        bound = f"one after the other from {start:g} to {end:g} s, each ending after it starts"
        remedy = "start each phase where the previous one ends"
        raise InputError("phases", spans, bound, remedy)


CURVES = (
    *("drones", "vertices", "legs", "tensions", "leg_tensions"),
    *("poses", "load_share", "contacts"),
)
"""Polynomial fields of every motion."""

SOURCES: dict[str, frozenset[str]] = {
    "leg_tensions": frozenset({"tensions"}),
    "poses": frozenset({"requirements", "drones"}),
    "load_share": frozenset({"requirements", "drones"}),
    "contacts": frozenset({"vertices", "team"}),
}
"""Curves that need not be passed, and the fields from which they follow without friction, wrapped
edges and objects that move."""

PLAIN: Any = None  # Stands for a curve that follows from its sources (``Motion``)
PLAIN_TOLERANCE = 1e-9  # [m], [N] Largest difference from a plain curve that counts as none

SHARE_TOLERANCE = 2.0**-40
"""Load shares this close to 0 or 1 are set to 0 or 1: elevating the degree rounds them."""


@dataclass(frozen=True, eq=False)
class Motion(OneLine):
    """The motion of one team: drones, vertices, legs and tensions, and the requirements on them.

    While no hitch exists, vertices and legs are undefined, and tensions are 0 except while cables
    are tightened, when they pull toward the vertices. Swarms of single drones have none of them.

    Parameters
    ----------
    team: the robots.
    requirements: limits, distances, and objects that the motion must respect.
    drones: shape (2n, 3) [m], in order along the hitch, as ``team.drone_names``;
        (N, 3) for single drones. ``Plan.at`` and all files have the order of the problem.
    vertices: shape (points, 3) [m]: n points of a closed hitch, n + 1 of a chain.
    legs: shape (n, 2) [m]: ``d_k``, ``e_k``; zero where a chain's end has no leg.
    tensions: shape (n,) [N].
    phases: contiguous phases that cover the motion.
    leg_tensions: shape (n, 2) [N]; by default, every leg pulls with its cable's tension. They
        differ where cables slide against friction.
    poses: shape (objects, 5): x, y, z [m] of the objects' bases, cosine and sine of yaw; by default
        where requirements place them.
    load_share: shape (objects,), fraction of each object's weight that clasps carry, from 0 (on its
        support, the default) to 1.
    contacts: shape (n, 2, 3) [m], first and last point at which edge k touches the section that it
        is wrapped around, one point if straight; by default the edges' midpoints.

    Raises
    ------
    InputError: mismatched shapes, breaks or phases.
    """

    team: Team
    requirements: Requirements
    drones: PiecewisePolynomial
    vertices: PiecewisePolynomial
    legs: PiecewisePolynomial
    tensions: PiecewisePolynomial
    phases: tuple[Phase, ...]
    leg_tensions: PiecewisePolynomial = PLAIN
    poses: PiecewisePolynomial = PLAIN
    load_share: PiecewisePolynomial = PLAIN
    contacts: PiecewisePolynomial = PLAIN

    def _parts(self) -> Iterator[str]:
        yield counted(self.team.drones, "drone")
        yield f"{self.duration:.4g} s, phases: {len(self.phases)}, pieces: {self.drones.pieces}"

    def __post_init__(self) -> None:
        self._check_types()
        n = self.team.robots
        objects = len(self.requirements.objects)
        shapes = {
            "drones": (self.team.drones, 3),
            "vertices": (self.team.layout.points, 3),
            "legs": (n, 2),
            "tensions": (n,),
            "leg_tensions": (n, 2),
            "poses": (objects, 5),
            "load_share": (objects,),
            "contacts": (n, 2, 3),
        }
        breaks = self.drones.breaks
        for name, shape in shapes.items():
            if getattr(self, name) is PLAIN:
                object.__setattr__(self, name, self._plain_curve(name))
            part: PiecewisePolynomial = getattr(self, name)
            if part.shape != shape:
                raise InputError(name, part.shape, f"of shape {shape}", "one row per robot's parts")
            if part.breaks is not breaks and not np.array_equal(part.breaks, breaks):
                raise InputError(
                    name, "its breaks", "those of the drones", "use the same breaks for both"
                )
        object.__setattr__(self, "load_share", _snapped(self.load_share))
        check_phases(self.phases, float(breaks[0]), float(breaks[-1]))
        if any(phase.state.has_cables is not self.team.has_cables for phase in self.phases):
            bound = "none without cables, another state with them"
            states = [str(phase.state) for phase in self.phases]
            raise InputError("phases.state", states, bound, "set the state of the cables")
        changes = [
            phase.start
            for previous, phase in pairwise(self.phases)
            if previous.state != phase.state
        ]
        if any(np.min(np.abs(time - breaks)) > JOINT for time in changes):
            remedy = "split the pieces there"
            raise InputError("phases", changes, "breaks where states change", remedy)

    def _check_types(self) -> None:
        """Raise InputError for a field of another type."""
        check_instance("team", self.team, Team)
        check_instance("requirements", self.requirements, Requirements)
        for name in CURVES:
            if getattr(self, name) is not PLAIN or name not in SOURCES:
                check_instance(name, getattr(self, name), PiecewisePolynomial)
        phases = sequence("phases", self.phases)
        object.__setattr__(self, "phases", phases)
        for index, phase in enumerate(phases):
            check_instance(f"phases[{index}]", phase, Phase)

    def _plain_curve(self, name: str) -> PiecewisePolynomial:
        """Return a curve of SOURCES as it is without friction, wrapped edges and moving objects."""
        layout = self.team.layout
        vertices = self.vertices.coefficients
        if name == "leg_tensions":
            tensions = self.tensions.coefficients
            return self.tensions.replaced(np.stack([tensions, tensions], axis=2))
        if name == "contacts":
            middles = 0.5 * (vertices[:, layout.starts] + vertices[:, layout.ends])
            return self.vertices.replaced(np.stack([middles, middles], axis=2))
        objects = self.requirements.objects
        rest = poses_of(objects) if name == "poses" else np.zeros(len(objects))
        return PiecewisePolynomial.constant(self.drones.breaks, rest)

    def _is_plain(self, name: str) -> bool:
        """Return whether a curve of SOURCES is as without friction, wraps and moving objects."""
        curve: PiecewisePolynomial = getattr(self, name)
        plain = self._plain_curve(name)
        if curve.shape != plain.shape:
            return False
        coefficients, plain_coefficients = same_degree(curve.coefficients, plain.coefficients)
        differences = np.abs(coefficients - plain_coefficients)
        return bool(np.max(differences, initial=0.0) <= PLAIN_TOLERANCE)

    @lazy
    def leg_tensions_differ(self) -> bool:
        """Return whether any leg's tension differs from its edge's, for example by friction."""
        return not self._is_plain("leg_tensions")

    @lazy
    def has_wraps(self) -> bool:
        """Return whether any edge has contacts with an object; otherwise all edges are straight."""
        return not self._is_plain("contacts")

    @lazy
    def inner_ends(self) -> PiecewisePolynomial:
        """(n, 2, 3) [m] Inner ends of legs, which are vertices."""
        vertices = self.vertices.coefficients[:, self.team.layout.anchors]
        shape = len(vertices), self.team.robots, 2, *vertices.shape[2:]
        return self.vertices.replaced(vertices.reshape(shape))

    @property
    def pull_points(self) -> PiecewisePolynomial:
        """(2n, 3) [m] Points toward which cables pull drones: inner ends, or a chain's vertices."""
        if self.team.layout.closed:
            return self.inner_ends.reshaped(-1, 3)
        return self.vertices.replaced(self.vertices.coefficients[:, self.team.layout.pulled_to])

    @classmethod
    def single(
        cls,
        team: Team,
        requirements: Requirements,
        drones: PiecewisePolynomial,
        phases: Sequence[Phase],
    ) -> Motion:
        """Return the motion of drones without a hitch.

        Phases of a team without cables get the state ``none``.
        """
        if not team.has_cables:
            phases = [replace(phase, state=CableState.NONE) for phase in phases]

        def zero(*shape: int) -> PiecewisePolynomial:
            return PiecewisePolynomial.constant(drones.breaks, np.zeros(shape))

        return cls(
            team,
            requirements,
            drones,
            vertices=zero(team.layout.points, 3),
            legs=zero(team.robots, 2),
            tensions=zero(team.robots),
            phases=tuple(phases),
        )

    @property
    def assignment(self) -> Assignment | None:
        """Places of the problem's robots, if they were chosen; otherwise robot k holds edge k."""
        return self.team.assignment

    @property
    def duration(self) -> float:
        """Duration of all phases [s]."""
        return self.drones.duration

    @property
    def untimed(self) -> Motion:
        """The motion without a limit on its duration."""
        untimed = self.requirements.untimed
        return self if untimed is self.requirements else self.replaced(requirements=untimed)

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Tension of the leg at each drone, q0, r0, q1, …, of shape (2n,) [N]."""
        return self.leg_tensions.reshaped(2 * self.team.robots)

    @lazy
    def cable_states(self) -> frozenset[CableState]:
        """States of the cables in all phases; without phases, ``HITCHED`` or ``NONE``."""
        if not self.phases:
            return frozenset({CableState.HITCHED if self.team.has_cables else CableState.NONE})
        return frozenset(phase.state for phase in self.phases)

    @property
    def formed(self) -> NDArray[np.bool_]:
        """(pieces,): whether the hitch exists, and cables are taut, on each piece."""
        return self.in_states(lambda state: state.hitched)

    @property
    def pulling(self) -> NDArray[np.bool_]:
        """(pieces,): whether cables pull drones with planned tensions on each piece."""
        return self.in_states(lambda state: state.pulls)

    def in_states(self, test: StateTest) -> NDArray[np.bool_]:
        """Return whether the state of the cables passes a test on each piece (pieces,)."""
        passes = {test(state) for state in self.cable_states}
        if len(passes) == 1:
            return np.full(self.drones.pieces, passes.pop())
        return self.in_phases(lambda phase: test(phase.state))

    def in_phases(self, condition: Callable[[Phase], bool]) -> NDArray[np.bool_]:
        """Return whether the phase of each piece meets a condition (pieces,).

        Without phases, no piece does.
        """
        fulfilled = np.array([*map(condition, self.phases), False])
        return np.asarray(fulfilled[self.phase_of_piece])

    @property
    def holding(self) -> NDArray[np.bool_]:
        """(pieces,): whether the cables hold an object on each piece."""
        return self.in_phases(lambda phase: phase.hold is not None)

    def hold_at(self, time: float) -> PhaseHold | None:
        """Return the hold at a time [s]; None if nothing is held then."""
        piece = int(np.searchsorted(self.drones.breaks, time, side="right")) - 1
        piece = min(max(piece, 0), self.drones.pieces - 1)
        hold: PhaseHold | None = self.phases[self.phase_of_piece[piece]].hold
        return hold

    @property
    def phase_of_piece(self) -> NDArray[np.intp]:
        """(pieces,): index of the phase that contains the middle of each piece."""
        middles = 0.5 * (self.drones.breaks[1:] + self.drones.breaks[:-1])
        ends = np.array([phase.end for phase in self.phases[:-1]])
        return np.asarray(np.searchsorted(ends, middles))

    def spans(self, test: StateTest) -> tuple[Motion, ...]:
        """Return the maximal runs of pieces on which the state of the cables passes a test.

        Each keeps its times and the phases that it overlaps.
        """
        selected = self.in_states(test)
        if np.all(selected):  # phases may be shorter than any piece
            return (self,)
        return tuple(self.on_pieces(*run) for run in true_runs(selected))

    def overlapping(self, start: float, end: float) -> tuple[Phase, ...]:
        """Return the phases that overlap the time from ``start`` to ``end`` [s]."""
        start += JOINT
        end -= JOINT
        return tuple([phase for phase in self.phases if phase.end > start and phase.start < end])

    def slice_pieces(self, pieces: slice, phases: Sequence[Phase]) -> Motion:
        """Return the motion on a run of pieces, at the same times, with other phases."""
        return self.map_curves(lambda part: part.slice_pieces(pieces), phases)

    def on_pieces(self, first: int, last: int) -> Motion:
        """Return the motion between two breaks, at the same times, with the phases there."""
        phases = self.overlapping(*self.drones.breaks[[first, last]].tolist())
        return self.slice_pieces(slice(first, last), phases)

    def map_curves(
        self, change: Callable[[PiecewisePolynomial], PiecewisePolynomial], phases: Sequence[Phase]
    ) -> Motion:
        """Return the motion with ``change`` applied to every polynomial, and other phases."""
        parts = {name: change(getattr(self, name)) for name in CURVES}
        return self.replaced(phases=tuple(phases), **parts)

    def replaced(self, **values: Any) -> Motion:
        """Return the motion with other values of some fields.

        Curves that are derived from other fields alone are derived from their new values. Only
        phases are checked: polynomials come from motions that were checked on construction.
        """
        motion = object.__new__(type(self))
        old_values = {name: vars(self)[name] for name in self.__dataclass_fields__}
        vars(motion).update(old_values | values)
        for name, sources in SOURCES.items():
            if name not in values and sources & values.keys() and self._is_plain(name):
                vars(motion)[name] = motion._plain_curve(name)
        if "load_share" in values:
            vars(motion)["load_share"] = _snapped(motion.load_share)
        if "phases" in values:
            breaks = motion.drones.breaks
            check_phases(motion.phases, float(breaks[0]), float(breaks[-1]))
        return motion

    def slowed(self, factor: float) -> Motion:
        """Return the same curves and phases, slowed down by ``factor``; the motion starts at 0."""
        phases = [phase.retimed(factor * phase.start, factor * phase.end) for phase in self.phases]
        return self.map_curves(lambda part: part.stretched(factor), phases)


def concatenated(motions: Sequence[Motion]) -> Motion:
    """Return the motions in sequence as one, with the first one's team and requirements."""
    if len(motions) == 1:
        return motions[0]
    ends = np.cumsum([0.0, *(motion.duration for motion in motions)]).tolist()
    phases = tuple(
        phase.retimed(start + phase.start, start + phase.end)
        for start, motion in zip(ends, motions, strict=False)
        for phase in motion.phases
    )
    parts: dict[str, Any] = {"drones": joined([motion.drones for motion in motions])}
    for name in CURVES[1:]:
        parts[name] = joined([getattr(motion, name) for motion in motions], parts["drones"])
    return motions[0].replaced(phases=phases, **parts)


def _snapped(share: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return load shares with those within SHARE_TOLERANCE of 0 or 1 set to 0 or 1."""
    shares = share.coefficients
    nearest = np.round(shares)
    is_near = np.abs(shares - nearest) <= SHARE_TOLERANCE
    return share.replaced(np.where(is_near, nearest, shares))
