"""Judgement of a flight: its outcome, its errors, its objects, and what a lost drone did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import length
from hitchopt.simulation.contacts import least_bearing
from hitchopt.simulation.flight import Flight, Progress, fly, ground_of
from hitchopt.simulation.settings import Settings
from hitchopt.simulation.task import Task, group_of
from hitchopt.simulation.world import BODY_HALF_HEIGHT
from hitchopt.values import Array

# Largest movement from one sample to the next of a vertex that is at rest [m], and largest change
# of a tension that is steady, over the team's
STILL = 1e-6

# Least tension over the team's at which a vertex counts; a hitch that is being drawn tight has
# ill-defined vertices
TIGHT = 0.5

ROUNDING = 1e-5  # Rounding of sample times [s]
HELD = 0.10  # Largest slip along its cables under the pull test of a vertex that is held [m]
JUDGED = 1.0  # Time of rest, and of the pull test, over which legs and forces are averaged [s]

# Largest distance [m] of an object from where the plan puts it down, and largest angle [°] to its
# planned attitude
PLACED, TILTED = 0.03, 5.0

DROPPED = 0.05  # Depth below its planned height from which on a carried object is dropped [m]
RELEASED = 0.2  # Last part of the rest in which no cable may touch an object that is free [s]
SETTLED = 0.5  # Last part of a flight over which it is judged where a lost drone hangs [s]

# Warning of a flight whose cables slide freely
NO_FRICTION = "friction is left at 0: at 0.1 hitches rest some 5 cm from their plans; "
NO_FRICTION += "state team.cable_friction, or give friction="

# Warning of what flies besides
BESIDES = "drones are on their set points, without cables; only hitches are simulated"

SUCCEEDED, FAILED, NOT_SIMULATED = "succeeded", "failed", "not simulated"

# Failures of the simulation itself: it could not begin, or left its valid range
UNSIMULATED = START, INVALID = "start", "invalid"


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation and largest value of some errors; nan where there are none."""

    mean: float = np.nan
    deviation: float = np.nan
    largest: float = np.nan

    @classmethod
    def of(cls, errors: Array) -> Spread:
        """Return the spread of the errors that exist (not nan)."""
        there = errors[np.isfinite(errors)]
        measures = (np.mean, np.std, np.max) if there.size else ()
        return cls(*(float(measure(there)) for measure in measures))


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Errors of the vertices while the plan has a hitch, drawn tight, and until it has rested.

    Attributes
    ----------
    t, rows: times [s] and places in the flight's record (samples,).
    planned: planned vertices (samples, clasps, 3) [m]; nan where a group has none, drawn tight.
    offsets: (samples, clasps, 3) [m], from these; nan where cables do not bear on each other.
    moving: whether the plan moves any vertex or changes any tension (samples,).
    """

    t: Array
    rows: NDArray[np.intp]
    planned: Array
    offsets: Array
    moving: NDArray[np.bool_]

    @property
    def errors(self) -> Array:
        """(samples, clasps) [m]: distances in three dimensions, sag included."""
        return length(self.offsets)

    @property
    def without_sag(self) -> Array:
        """(samples, clasps) [m]: the level part of the distances."""
        return length(self.offsets[..., :2])


def vertex_errors(flight: Flight) -> VertexErrors:
    """Return the errors at the samples of a flight; the pull test does not count.

    The first sample does not count either: no contact forces were gathered before it.
    """
    task, record = flight.task, flight.record
    tight, moves = list[Array](), np.zeros(len(task.t), np.bool_)
    for part in task.parts:
        tension, formed = part.team.tension, part.formed
        tight.append(formed & np.all(part.tensions >= TIGHT * tension, axis=-1))
        shifts = length(np.diff(part.vertices, axis=0))
        changes = np.abs(np.diff(part.tensions, axis=0)) / tension
        still = np.all(np.concatenate([shifts, changes], axis=-1) <= STILL, axis=-1)
        moves[1:] |= ~still & formed[1:] & formed[:-1]
    there = task.clasped(tight)
    end = np.fmax(task.duration, flight.rested) + ROUNDING
    rows = np.flatnonzero(
        (record.t > ROUNDING) & (record.t <= end) & there[record.index].any(axis=-1)
    )
    t, index = record.t[rows], record.index[rows]
    planned = task.vertices[index][:, task.team.layout.clasps]
    planned = np.where(there[index, :, None], planned, np.nan)
    moving = moves[index] & (t <= task.duration + ROUNDING)
    return VertexErrors(t, rows, planned, record.vertices[rows] - planned, moving)


def tracking_errors(flight: Flight) -> Array:
    """Return (samples, 2n) [m]: distances of drones from their commands, until the flight's end."""
    record = flight.record
    during = record.t <= flight.task.duration + ROUNDING
    return length(record.drones[during] - record.commanded[during])


@dataclass(frozen=True)
class Failure:
    """One failure at a time [s] from the flight's start, in words; ``where`` names things.

    Kinds are those of UNSIMULATED; ``touch``, ``unlinked``, ``tangled``, ``lost`` (cables that do
    not bear on each other), ``slipped`` (under the pull test); of objects ``dropped``,
    ``misplaced`` and ``caught`` (not free at the end).
    """

    kind: str
    where: tuple[str, ...]
    time: float
    words: str


@dataclass(frozen=True)
class Clasp:
    """State of one vertex at the end of a flight.

    Attributes
    ----------
    name: p0, p1, ….
    linking: Gauss's linking number of its two cables, ±1 for a clasp.
    bearing, least_bearing: contact force at rest, and that from which on it bears [N]: cables that
        merely cross may be linked too.
    moved: slip along its cables under the pull test [m], the larger change of its two legs'
        lengths; nan without one. Soft drones that drift, or draw slack cables tight, are no slip.
    holds: whether it is linked once, bears and is held.
    bears: whether its cables press on each other as those of a clasp do.
    """

    name: str
    linking: int
    bearing: float
    least_bearing: float
    moved: float
    holds: bool
    bears: bool


@dataclass(frozen=True)
class ObjectState:
    """State of one object at rest, and how it was held.

    Attributes
    ----------
    name: of the object.
    placed: distance of its base from the plan's [m].
    tilted, turned: angle of its axis from the vertical, and of its yaw from the plan's [°].
    slipped: largest movement relative to the hitch while that carries all of it [m]; nan if never.
    dropped: time at which it was first DROPPED below its plan while carried [s]; nan if never.
    free: whether no cable touches it.
    round: whether it looks the same however it is turned.
    """

    name: str
    placed: float
    tilted: float
    turned: float
    slipped: float
    dropped: float
    free: bool
    round: bool

    @property
    def well_placed(self) -> bool:
        """Whether it is where the plan puts it, and upright."""
        turned = 0.0 if self.round else abs(self.turned)
        return self.placed <= PLACED and max(self.tilted, turned) <= TILTED


@dataclass(frozen=True)
class Outcome:
    """All failures by time, the movable objects, and the vertices of a plan that ends with some."""

    clasps: tuple[Clasp, ...]
    failures: tuple[Failure, ...]
    objects: tuple[ObjectState, ...] = ()

    @property
    def verdict(self) -> str:
        """SUCCEEDED, FAILED, or NOT_SIMULATED where nothing but the simulation failed."""
        simulated = any(failure.kind not in UNSIMULATED for failure in self.failures)
        return FAILED if simulated else NOT_SIMULATED if self.failures else SUCCEEDED

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return not self.failures

    @property
    def hitched(self) -> bool:
        """Whether there are vertices and all of them hold."""
        return bool(self.clasps) and all(clasp.holds for clasp in self.clasps)


def judge(flight: Flight) -> Outcome:
    """Return the outcome of a flight.

    Where its plan ends with a hitch every vertex must hold, else the cables must be free of each
    other. Objects must be where the plan puts them, and free unless it ends holding them.
    After the loss of a drone nothing is judged but contacts of survivors.
    """
    lost, names = flight.settings.lost, set(flight.task.team.drone_names)
    failures = [
        Failure("touch", pair, time, " touches ".join(pair))
        for pair, time in flight.touches.items()
        if lost is None or time < lost.time or set(pair) & (names - {lost.drone})
    ]
    if (error := flight.error) is not None:
        failures.append(Failure(INVALID, (error.where,), error.time, str(error)))
    clasps: tuple[Clasp, ...] = ()
    objects: tuple[ObjectState, ...] = ()
    if lost is None:
        if flight.linking is not None:
            clasps = _clasps(flight, flight.linking) if flight.task.formed[-1] else ()
            failures += _loose(flight, flight.linking, clasps)
        objects = object_states(flight)
        failures += [failure for each in objects for failure in _mishandled(flight, each)]
    return Outcome(clasps, tuple(sorted(failures, key=lambda failure: failure.time)), objects)


def _clasps(flight: Flight, links: NDArray[np.int64]) -> tuple[Clasp, ...]:
    """Return the state of every vertex that the plan ends with."""
    team, layout = flight.task.team, flight.task.team.layout
    last = flight.task.clasped([part.formed[-1] for part in flight.task.parts])
    before, bearing = _means(flight, flight.rested)
    moved = np.max(np.abs(_means(flight, flight.pulled)[0] - before), axis=-1)
    held = (moved <= HELD) | np.isnan(flight.pulled)  # without a pull test both are nan
    linking, least = links[layout.behind, layout.ahead], least_bearing(flight.task)[-1]
    bears = (bearing >= least) & (least > 0.0)
    holds = (np.abs(linking) == 1) & bears & held & (flight.error is None)
    names = [team.point_names[point] for point in layout.clasps]
    columns = (column.tolist() for column in (linking, bearing, least, moved, holds, bears))
    each = zip(names, *columns, strict=True)
    return tuple(Clasp(*values) for values, there in zip(each, last, strict=True) if there)


def _means(flight: Flight, end: float) -> tuple[Array, Array]:
    """Return means over the last JUDGED seconds until ``end`` [s].

    They are of legs' lengths (clasps, 2) [m], nan without vertices, and contact forces (clasps,).
    """
    record, layout = flight.record, flight.task.team.layout
    chosen = (record.t > end - JUDGED) & (record.t <= end + ROUNDING)
    ends = record.drones[chosen][:, np.stack([2 * layout.ahead, 2 * layout.behind + 1], axis=-1)]
    legs, bearing = length(ends - record.vertices[chosen][:, :, None]), record.bearing[chosen]
    sums, counts = np.nansum(legs, axis=0), np.sum(np.isfinite(legs), axis=0)
    means: Array = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
    return means, np.sum(bearing, axis=0) / max(len(bearing), 1)


def _loose(flight: Flight, linking: NDArray[np.int64], clasps: tuple[Clasp, ...]) -> list[Failure]:
    """Return cables that are not linked as the plan's end requires, and clasps that do not hold."""
    task, layout, rested, failures = flight.task, flight.task.team.layout, flight.rested, []
    apart = np.triu(linking, 1)
    last = task.clasped([part.formed[-1] for part in task.parts])
    ahead, behind = layout.ahead[last], layout.behind[last]
    apart[behind, ahead] = apart[ahead, behind] = 0
    for i, j in np.argwhere(apart).tolist():
        one, other = cables = (flight.cable_names[i], flight.cable_names[j])
        words = f"{one} and {other} are linked {linking[i, j]} times, and should not be"
        failures.append(Failure("tangled", cables, rested, words))
    for each in clasps:
        force, least, moved = f"{each.bearing:.3f} N", f"{each.least_bearing:.3f} N", each.moved
        cases = (  # of which the first one counts
            (abs(each.linking) != 1, "unlinked", f"is linked {each.linking} times, not once"),
            (not each.bears, "lost", f"presses with {force}, less than {least}: cables cross"),
            (moved > HELD, "slipped", f"slips {moved:.3f} m under the pull test, more than {HELD}"),
        )
        for kind, words in [case for wrong, *case in cases if wrong][:1]:
            when = flight.pulled if kind == "slipped" else rested
            failures.append(Failure(kind, (each.name,), when, f"{each.name} {words}"))
    return failures


def _mishandled(flight: Flight, state: ObjectState) -> list[Failure]:
    """Return the failures of an object."""
    cargo, ended, rested = flight.task.cargo, flight.linking is not None, flight.rested
    held, dropped = cargo.held[-1, cargo.names.index(state.name)], bool(np.isfinite(state.dropped))
    off = (
        f" is {100 * state.placed:.1f} cm from its place, tilted by {state.tilted:.1f}°, turned by "
        f"{state.turned:.1f}°; at most {100 * PLACED:g} cm and {TILTED:g}°"
    )
    depth = f" is dropped: more than {100 * DROPPED:g} cm below its planned height"
    cases = (
        (dropped, "dropped", state.dropped, depth),
        (ended and not state.well_placed, "misplaced", rested, off),
        (ended and not (state.free or held), "caught", rested, ": cables touch it still"),
    )
    return [
        Failure(kind, (state.name,), when, state.name + words)
        for wrong, kind, when, words in cases
        if wrong
    ]


def object_states(flight: Flight) -> tuple[ObjectState, ...]:
    """Return the states of all objects that can move, at the end of the rest or of the record."""
    task, record, cargo = flight.task, flight.record, flight.task.cargo
    if not cargo.movable.any():
        return ()
    rested = bool(np.isfinite(flight.rested))
    end = flight.rested if rested else record.t[-1]
    t = record.t[record.t <= end + ROUNDING]
    rows, poses, touched = (x[: len(t)] for x in (record.index, record.poses, record.touched))
    plan, resting = cargo.poses[rows], t > end - JUDGED if rested else t == end
    yaws = np.arctan2(plan[-1, :, 4], plan[-1, :, 3])
    offsets = poses[..., :3] - plan[..., :3]
    planned = task.vertices[rows][:, task.team.layout.clasps]
    vertices, states = record.vertices[: len(t)] - planned, []
    groups = np.array([group_of(task.team.point_names[p]) for p in task.team.layout.clasps])
    for i in np.flatnonzero(cargo.movable):
        name, carried = cargo.names[i], cargo.carried[rows, i]
        hitch = np.mean(vertices[:, groups == cargo.holders.get(name, "")], axis=1)
        turned = Rotation.from_quat(poses[resting, i, 3:], scalar_first=True).mean()
        axes = (Rotation.from_euler("z", -yaws[i]) * turned).as_matrix()
        low = t[carried & (offsets[:, i, 2] < -DROPPED)]
        states.append(
            ObjectState(
                name,
                placed=float(length(np.mean(offsets[resting, i], axis=0))),
                tilted=float(np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0)))),
                turned=float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))),
                slipped=_slipped(offsets[:, i] - hitch, carried),
                dropped=float(np.min(low)) if low.size else np.nan,
                free=not touched[t > end - RELEASED, i].any(),
                round=all(slab.section.radius is not None for slab in cargo.objects[name].slabs),
            )
        )
    return tuple(states)


def _slipped(offsets: Array, carried: NDArray[np.bool_]) -> float:
    """Return how far an object moves from where it was as it was lifted [m], at most.

    ``offsets`` (samples, 3) [m] are from the hitch, nan where there is none.
    """
    chosen = np.flatnonzero(carried & np.isfinite(offsets[:, 0]))
    times = np.split(chosen, np.flatnonzero(np.diff(np.cumsum(~carried)[chosen])) + 1)
    slips = [float(np.max(length(offsets[run] - offsets[run[0]]))) for run in times if len(run)]
    return max(slips, default=np.nan)


@dataclass(frozen=True)
class LossOutcome(OneLine):
    """Outcome for a team after the loss of a drone at a time [s].

    Attributes
    ----------
    among, others: pairs of survivors that touch; survivors that touch a cable or the lost drone.
    peak_tension, moved: largest tension of a cable [N], and distance of a survivor from its
        setpoint [m], from the loss on.
    hangs: mean height of the lost drone over the ground at the end [m]; about 0 where it lies.
    linked: clasps whose cables are linked at the end, by name.
    """

    drone: str
    time: float
    among: tuple[tuple[str, str], ...]
    others: tuple[tuple[str, str], ...]
    peak_tension: float
    moved: float
    hangs: float
    linked: tuple[str, ...]

    @property
    def apart(self) -> bool:
        """Whether no two survivors touch."""
        return not self.among


def loss_outcome(flight: Flight) -> LossOutcome | None:
    """Return the outcome for a flight's team after the loss of a drone; None without one."""
    record, team, loss = flight.record, flight.task.team, flight.settings.lost
    if loss is None:
        return None
    after = record.t >= min(loss.time - 1e-9, record.t[-1])
    survivors = np.array(team.drone_names) != loss.drone
    names = set(team.drone_names) - {loss.drone}
    late = [p for p, t in flight.touches.items() if t >= loss.time - 1e-9 and set(p) & names]
    end = record.drones[record.t > record.t[-1] - SETTLED][:, ~survivors, 2]
    layout, linked = team.layout, np.zeros(0, dtype=np.intp)
    if flight.linking is not None:
        linked = layout.clasps[np.abs(flight.linking[layout.behind, layout.ahead]) == 1]
    return LossOutcome(
        loss.drone,
        loss.time,
        tuple(pair for pair in late if set(pair) <= names),
        tuple(pair for pair in late if not set(pair) <= names),
        float(np.max(record.peak_tensions[after])),
        float(np.max(length(record.drones - record.commanded)[after][:, survivors])),
        float(np.mean(end)) - ground_of(flight.task) - BODY_HALF_HEIGHT,
        tuple(team.point_names[point] for point in linked),
    )


@dataclass(frozen=True)
class Run(OneLine):
    """Row of a campaign for one flight: seed, verdict, failures by time, and figures by name.

    A flight that could not begin has no figures. The same seed gives the same flight.
    """

    seed: int
    verdict: str
    failures: tuple[Failure, ...]
    figures: dict[str, float]

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.verdict == SUCCEEDED


@dataclass(frozen=True, eq=False)
class Simulation(OneLine):
    """A judged flight, and the errors of its vertices."""

    flight: Flight
    outcome: Outcome
    errors: VertexErrors

    @property
    def settings(self) -> Settings:
        """Settings of the flight."""
        return self.flight.settings

    @property
    def loss(self) -> LossOutcome | None:
        """Outcome for the other drones after a loss; None if no drone was lost."""
        return loss_outcome(self.flight)

    @property
    def spreads(self) -> dict[str, Spread]:
        """Spreads [m] of vertices' errors, sag included, and of drones' from their commands."""
        errors = self.errors
        return {
            "vertex_error": Spread.of(errors.errors),
            "resting": Spread.of(errors.errors[~errors.moving]),
            "moving": Spread.of(errors.errors[errors.moving]),
            "without_sag": Spread.of(errors.without_sag),
            "tracking": Spread.of(tracking_errors(self.flight)),
        }

    @property
    def figures(self) -> dict[str, float]:
        """Figures by name, nan where there is none, such as ``tracking_mean``.

        Besides spreads ``peak_tension`` and ``peak_thrust`` [N], ``peak_tilt`` [°], and the largest
        ``placed`` [m], ``tilted`` [°] and ``slipped`` [m] of objects.
        """
        record = self.flight.record
        spreads = self.spreads.items()
        values = {f"{name}_{key}": v for name, spread in spreads for key, v in vars(spread).items()}
        values["peak_tension"] = float(np.max(record.peak_tensions))
        values["peak_thrust"] = float(np.max(record.thrusts))
        values["peak_tilt"] = float(np.degrees(np.max(record.tilts)))
        for name in ("placed", "tilted", "slipped"):
            column = [np.nan, *(getattr(each, name) for each in self.outcome.objects)]
            values[name] = float(np.fmax.reduce(column))
        return values

    @property
    def run(self) -> Run:
        """Row of a campaign for this flight."""
        return Run(self.settings.seed, self.outcome.verdict, self.outcome.failures, self.figures)


def nearest(flight: Flight) -> tuple[tuple[str, str], float, float]:
    """Return the two drones that come nearest, by name, their distance [m], and when [s].

    Those that are not simulated count with the others; two of them do not.
    """
    task, record = flight.task, flight.record
    names = (*task.team.drone_names, *task.passing.names)
    drones = np.concatenate([record.drones, task.passing.at(record.index)], axis=1)
    pairs, least = list[int](), list[float]()
    count = task.team.drones
    for row in drones:
        between = cdist(row[:count], row)
        np.fill_diagonal(between, np.inf)
        pairs.append(int(np.argmin(between)))
        least.append(float(np.min(between)))
    first = int(np.argmin(least))
    i, j = divmod(pairs[first], len(names))
    return (names[i], names[j]), least[first], float(record.t[first])


def warnings(task: Task, settings: Settings) -> tuple[str, ...]:
    """Return warnings about a flight: friction that is left at 0, and what is not simulated."""
    free = any(not part.team.cable_friction for part in task.parts)
    found = [NO_FRICTION] if settings.friction is None and free else []
    if task.passing.names:
        names = dict.fromkeys(map(group_of, task.passing.names))
        found.append(f"{', '.join(names)}: {BESIDES}")
    return tuple(found)


def simulate(task: Task, settings: Settings, progress: Progress | None = None) -> Simulation:
    """Return the judged flight of a task; parameters and errors are those of ``fly``."""
    flight = fly(task, settings, progress)
    return Simulation(flight, judge(flight), vertex_errors(flight))
