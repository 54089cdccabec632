"""Motion of a team: the polynomials of a plan, its phases and its requirements."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError, OneLine, UnsupportedError
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.objects.placing import poses_of
from hitchopt.trajectory import PiecewisePolynomial, joined

JOINT = 1e-6
"""[s] Phases meet within this, and cables change their state within this of a break."""

WAIT = "wait"
"""Name of phases in which a group rests because others fly."""


class CableState(StrEnum):
    """State of the cables in a phase; the certificate verifies it from the polynomials.

    While cables are not hitched, vertices, legs and tensions have no meaning, except that
    vertices are where the clasps may lie while cables are being tightened. On the ground, cables
    lie there at least in part and drones fly straight up or down; in clasping, drones of
    neighbouring cables turn about each other. Cables that are laid are taut by themselves and move
    without turning; where they roll, they lie across each other at some clasps, or turn there from
    that into a clasp or back, with all vertices at rest. Lying across, they pass weight to one
    another as a robot has joined them, or is about to leave.
    """

    NONE = "none"
    GROUND = "on the ground"
    FREE = "hanging free"
    CLASPING = "clasping"
    TIGHTENING = "being tightened"
    LAYING = "being laid"
    LYING = "lying across"
    ROLLING = "rolling"
    HITCHED = "hitched"


HITCHED_STATE = frozenset({CableState.HITCHED, CableState.ROLLING, CableState.LYING})
"""The states in which the hitch exists: vertices, legs and tensions have a meaning."""

FREE_STATES = frozenset(CableState) - HITCHED_STATE - {CableState.NONE}
"""States of cables without a hitch."""


class HoldBy(StrEnum):
    """Kind of hold: the object's rim rests on the clasps, or cables grip its section."""

    REST = "rest"
    GRIP = "grip"


@dataclass(frozen=True)
class Hold:
    """An object that a hitch holds in a phase, by its name, how, and with which cables.

    The certificate verifies it from the polynomials: these cables may touch it.
    """

    object: str
    by: HoldBy
    cables: tuple[int, ...]


@dataclass(frozen=True)
class Phase(OneLine):
    """A span of a plan's time.

    Attributes
    ----------
    name: such as ``morph`` or ``hold``; a label without effect.
    step: index of its step in the mission.
    start, end: [s]
    remark: deviation from the request and its reason; usually empty.
    state: of the cables.
    tension: smallest and largest tension [N] that the step allows during its motion, None for the
        team's. Part of the problem: the check ``tension`` requires it, and the team's tensions at
        both ends.
    hold: the object that the hitch holds, which its cables may touch; None without one.
    ring: the robots that hold the edges, in order; None for all of the team, by their numbers.
        Vertices are counted along it.
    waiting: the robots that are not among them, each with the state of its cable.
    """

    name: str
    step: int
    start: float
    end: float
    remark: str = ""
    state: CableState = CableState.HITCHED
    tension: tuple[float, float] | None = None
    hold: Hold | None = None
    ring: tuple[int, ...] | None = None
    waiting: tuple[tuple[int, CableState], ...] = ()

    @property
    def formed(self) -> bool:
        """Whether the hitch exists."""
        return self.state in HITCHED_STATE

    def retimed(self, start: float, end: float) -> Phase:
        """Return the phase with other times [s]."""
        return replace(self, start=start, end=end)


def check_phases(phases: Sequence[Phase], start: float, end: float) -> None:
    """Raise InputError unless phases follow one another and cover the time from start to end [s].

    They may begin earlier and end later: a part of a motion has all phases that it overlaps.
    """
    spans = [[phase.start, phase.end] for phase in phases]
    covered = not spans or (spans[0][0] <= start + JOINT and spans[-1][1] >= end - JOINT)
    joined_up = all(abs(b[0] - a[1]) <= JOINT for a, b in pairwise(spans))
    if not (covered and joined_up and all(first < last for first, last in spans)):
        bound = f"one after the other from {start:g} to {end:g} s, each ending after it starts"
        remedy = "give each phase the time from the end of the one before to its own end"
        raise InputError("phases", spans, bound, remedy)


@dataclass(frozen=True, eq=False)
class Group:
    """A motion among several on one clock, under its team's name, which is empty if it is alone.

    Of somebody else's plan, ``digest`` is that of its file, and ``plan`` its path as written.
    """

    name: str
    motion: Motion
    digest: str = ""
    plan: str = ""

    def label(self, place: str) -> str:
        """Return the name of a drone, cable or vertex of it among all groups'."""
        return f"{self.name}.{place}" if self.name else place


POLYNOMIALS = ("drones", "vertices", "legs", "tensions")
"""Fields of every motion that are polynomials."""

OPTIONAL_CURVES = ("leg_tensions", "poses", "borne", "contacts")
"""Fields that are polynomials only if cables slide against friction or objects are held."""

SHARE_TOLERANCE = 2.0**-40
"""Load shares this close to 0 or 1 are taken as 0 or 1: raising the degree rounds them."""


@dataclass(frozen=True, eq=False)
class Motion(OneLine):
    """Drones, vertices, legs and tensions over time, and the requirements on them.

    While no hitch exists, vertices, legs and tensions have no meaning and tensions are 0. A team of
    single drones has none of them.

    Parameters
    ----------
    team: the robots that fly.
    requirements: limits, distances, and objects that the motion must respect.
    drones: of shape (2n, 3) [m], in the order q0, r0, q1, r1, …; (N, 3) of single drones.
    vertices: of shape (points, 3) [m]: n points of a closed hitch, n + 1 of a chain.
    legs: of shape (n, 2) [m]: ``d_k``, ``e_k``; zero where a chain's end has none.
    tensions: of shape (n,) [N].
    phases: one after the other, covering all of the time.
    assignment: which robots fly which roles, where that was chosen.
    leg_tensions: of shape (n, 2) [N], if cables slide against friction; None if every leg pulls
        with its cable's tension.
    poses: of shape (objects, 5): x, y, z [m] of the objects' bases, cosine and sine of their yaws;
        None if no object moves.
    borne: of shape (objects,), the share of each object's weight that clasps carry, from 0 (it
        stands) to 1; None if they carry none.
    contacts: of shape (n, 2, 3) [m], where edge k meets and leaves the section that it is wrapped
        around, the same point if straight; None if all edges are straight.
    others: plans of somebody else that fly besides, at their times on this motion's clock; at rest
        before and after. All distances to them are kept.

    Raises
    ------
    InputError: shapes, breaks or phases that do not fit.
    """

    team: Team
    requirements: Requirements
    drones: PiecewisePolynomial
    vertices: PiecewisePolynomial
    legs: PiecewisePolynomial
    tensions: PiecewisePolynomial
    phases: tuple[Phase, ...]
    assignment: Assignment | None = None
    leg_tensions: PiecewisePolynomial | None = None
    poses: PiecewisePolynomial | None = None
    borne: PiecewisePolynomial | None = None
    contacts: PiecewisePolynomial | None = None
    others: tuple[Group, ...] = ()

    def _parts(self) -> Iterator[str]:
        yield f"{self.team.drones} drones"
        yield f"{self.duration:.4g} s, phases: {len(self.phases)}, pieces: {self.drones.pieces}"

    def __post_init__(self) -> None:
        n, objects = self.team.robots, len(self.requirements.objects)
        shapes = {
            "drones": (self.team.drones, 3),
            "vertices": (self.team.layout.points, 3),
            "legs": (n, 2),
            "tensions": (n,),
            "leg_tensions": (n, 2),
            "poses": (objects, 5),
            "borne": (objects,),
            "contacts": (n, 2, 3),
        }
        breaks = self.drones.breaks
        for name, part in self._polynomials.items():
            if part.shape != shapes[name]:
                bound = f"of shape {shapes[name]}"
                raise InputError(name, part.shape, bound, "one row per robot's parts")
            if part.breaks is not breaks and not np.array_equal(part.breaks, breaks):
                raise InputError(name, "its breaks", "those of the drones", "split them alike")
        check_phases(self.phases, float(breaks[0]), float(breaks[-1]))
        if any((phase.state == CableState.NONE) is self.team.has_cables for phase in self.phases):
            bound = "none without cables, another state with them"
            states = [str(phase.state) for phase in self.phases]
            raise InputError("phases.state", states, bound, "state what cables do")
        changes = [b.start for a, b in pairwise(self.phases) if a.state != b.state]
        if any(np.min(np.abs(time - breaks)) > JOINT for time in changes):
            remedy = "split the pieces there"
            raise InputError("phases", changes, "breaks where states change", remedy)
        roles = n if self.assignment is None else len(self.assignment.robots)
        if roles != n:
            raise InputError("assignment", roles, f"{n} robots", "give one per role")

    @property
    def _polynomials(self) -> dict[str, PiecewisePolynomial]:
        own = vars(self)
        return {name: own[name] for name in POLYNOMIALS + OPTIONAL_CURVES if own[name] is not None}

    @classmethod
    def single(
        cls,
        team: Team,
        requirements: Requirements,
        drones: PiecewisePolynomial,
        phases: Sequence[Phase],
    ) -> Motion:
        """Return the motion of drones without a hitch.

        The state of its phases becomes ``none`` if there are no cables.
        """
        shapes = (team.layout.points, 3), (team.robots, 2), (team.robots,)
        vertices, legs, tensions = (
            PiecewisePolynomial.constant(drones.breaks, np.zeros(shape)) for shape in shapes
        )
        if not team.has_cables:
            phases = [replace(phase, state=CableState.NONE) for phase in phases]
        return cls(team, requirements, drones, vertices, legs, tensions, tuple(phases))

    @property
    def changes(self) -> bool:
        """Whether some of its robots are, at some time, in no ring (``motion.chapters``)."""
        return any(phase.ring is not None for phase in self.phases)

    @property
    def groups(self) -> tuple[Group, ...]:
        """The motions side by side; itself, unless several were combined."""
        return (Group("", self),)

    @property
    def flying(self) -> tuple[Group, ...]:
        """Its groups and all ``others``."""
        return self.groups + self.others

    def each_group(self, change: Callable[[Motion], Motion]) -> Motion:
        """Return the motion with a change of every group's clock applied."""
        return change(self)

    @property
    def has_cables(self) -> bool:
        """Whether any of its teams has cables."""
        return any(each.motion.team.has_cables for each in self.groups)

    def refuse_several(self, what: str, *, others: bool = True) -> None:
        """Raise UnsupportedError for several groups, or others, which ``what`` does not know.

        Neither does it know hitches that change their robots.
        """
        if self.changes:
            words = f"{what} knows hitches of the same robots all the time"
            raise UnsupportedError(f"{words}; plan what is before or after in a file of its own")
        flying = self.flying if others else self.groups
        if len(flying) > 1:
            names = ", ".join(each.name or "the team" for each in flying)
            words = f"{what} knows one team alone, and here fly {names}"
            raise UnsupportedError(f"{words}; plan that team in a file of its own")

    @property
    def duration(self) -> float:
        """Duration of all phases together [s]."""
        return self.drones.duration

    @property
    def untimed(self) -> Motion:
        """The motion without a limit on its duration."""
        needed = self.requirements.untimed
        return self if needed is self.requirements else self.replaced(requirements=needed)

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Tension of the leg at each drone, q0, r0, q1, …, of shape (2n,) [N]."""
        if self.leg_tensions is None:
            return self.drones.alike(np.repeat(self.tensions.coefficients, 2, axis=1))
        return self.leg_tensions.reshaped(self.team.drones)

    @property
    def object_poses(self) -> PiecewisePolynomial:
        """Poses of all objects, as ``poses``; constant if none moves."""
        if self.poses is not None:
            return self.poses
        return PiecewisePolynomial.constant(self.drones.breaks, poses_of(self.requirements.objects))

    @property
    def object_shares(self) -> PiecewisePolynomial:
        """Shares of objects' weights that clasps carry, as ``borne``; 0 if they carry none.

        Shares that differ from 0 or 1 by rounding alone are 0 or 1.
        """
        if self.borne is None:
            none = np.zeros(len(self.requirements.objects))
            return PiecewisePolynomial.constant(self.drones.breaks, none)
        c, nearest = self.borne.coefficients, np.round(self.borne.coefficients)
        return self.borne.alike(np.where(np.abs(c - nearest) <= SHARE_TOLERANCE, nearest, c))

    @property
    def edge_contacts(self) -> PiecewisePolynomial:
        """Contacts of all edges, as ``contacts``; the edges' middles if all are straight."""
        if self.contacts is not None:
            return self.contacts
        c, layout = self.vertices.coefficients, self.team.layout
        middles = 0.5 * (c[:, layout.starts] + c[:, layout.ends])
        return self.vertices.alike(np.stack([middles, middles], axis=2))

    @property
    def cable_states(self) -> frozenset[CableState]:
        """States of the cables in the phases; without phases hitched, or none without cables."""
        if not self.phases:
            return frozenset({CableState.HITCHED if self.team.has_cables else CableState.NONE})
        return frozenset(phase.state for phase in self.phases)

    @property
    def formed(self) -> NDArray[np.bool_]:
        """(pieces,): whether the hitch exists on each piece."""
        return self.in_states(HITCHED_STATE)

    def in_states(self, states: Set[CableState]) -> NDArray[np.bool_]:
        """Return (pieces,) whether the cables are in one of the states on each piece."""
        here = self.cable_states
        if here <= states or here.isdisjoint(states):
            return np.full(self.drones.pieces, here <= states)
        in_phase: NDArray[np.bool_] = np.array([p.state in states for p in self.phases])
        return in_phase[self.phase_of_piece]

    @property
    def phase_of_piece(self) -> NDArray[np.intp]:
        """(pieces,): index of the phase in which the middle of each piece lies."""
        middles = 0.5 * (self.drones.breaks[1:] + self.drones.breaks[:-1])
        ends = np.array([phase.end for phase in self.phases[:-1]])
        index: NDArray[np.intp] = np.searchsorted(ends, middles)
        return index

    def spans(self, states: Set[CableState]) -> tuple[Motion, ...]:
        """Return the longest runs of pieces on which the cables are in one of the states.

        Each keeps its times and has the phases that it overlaps.
        """
        wanted = self.in_states(states)
        if np.all(wanted):  # phases may be shorter than any piece
            return (self,)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]])))
        breaks = self.drones.breaks
        return tuple(
            self.slice_pieces(slice(first, last), self.overlapping(breaks[first], breaks[last]))
            for first, last in edges.reshape(-1, 2).tolist()
        )

    def overlapping(self, start: float, end: float) -> tuple[Phase, ...]:
        """Return the phases that overlap the time from ``start`` to ``end`` [s]."""
        start, end = start + JOINT, end - JOINT
        return tuple([p for p in self.phases if p.end > start and p.start < end])

    def slice_pieces(self, pieces: slice, phases: Sequence[Phase]) -> Motion:
        """Return the motion on a run of pieces, at the same times, with these phases."""
        return self.map_curves(lambda part: part.slice_pieces(pieces), phases)

    def map_curves(
        self, change: Callable[[PiecewisePolynomial], PiecewisePolynomial], phases: Sequence[Phase]
    ) -> Motion:
        """Return the motion with ``change`` applied to every polynomial, and other phases."""
        parts = {name: change(part) for name, part in self._polynomials.items()}
        return self.replaced(phases=tuple(phases), **parts)

    def replaced(self, **values: Any) -> Motion:
        """Return the motion with other values of some fields, which must fit it.

        Only phases are checked: polynomials come from motions that were checked on construction.
        """
        motion, own = object.__new__(type(self)), vars(self)
        vars(motion).update({name: own[name] for name in self.__dataclass_fields__} | values)
        if "phases" in values:
            breaks = motion.drones.breaks
            check_phases(motion.phases, float(breaks[0]), float(breaks[-1]))
        return motion

    def slowed(self, factor: float) -> Motion:
        """Return the same curves, from t = 0, and phases ``factor`` times as slow."""
        phases = [p.retimed(factor * p.start, factor * p.end) for p in self.phases]
        return self.map_curves(lambda part: part.stretched(factor), phases)


def joined_motions(motions: Sequence[Motion]) -> Motion:
    """Return one motion of the given ones in a row, with the first one's team and requirements.

    In each motion, objects that do not move stand where its own requirements place them.
    """
    if len(motions) == 1 and motions[0].poses is None and motions[0].borne is None:
        return motions[0]
    ends = np.cumsum([0.0, *(motion.duration for motion in motions)]).tolist()
    phases = tuple(
        phase.retimed(start + phase.start, start + phase.end)
        for start, motion in zip(ends, motions, strict=False)
        for phase in motion.phases
    )
    parts: dict[str, Any] = {"drones": joined([motion.drones for motion in motions])}
    for name in POLYNOMIALS[1:]:
        parts[name] = joined([getattr(motion, name) for motion in motions], parts["drones"])
    used = {
        name for motion in motions for name in OPTIONAL_CURVES if getattr(motion, name) is not None
    }
    if "leg_tensions" in used:
        parts["leg_tensions"] = joined([motion.pulls for motion in motions]).reshaped(-1, 2)
    if used & {"poses", "borne"}:
        parts["poses"] = joined([motion.object_poses for motion in motions])
        parts["borne"] = joined([motion.object_shares for motion in motions])
    if "contacts" in used:
        parts["contacts"] = joined([motion.edge_contacts for motion in motions])
    return motions[0].replaced(phases=phases, **parts)
