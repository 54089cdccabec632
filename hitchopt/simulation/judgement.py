"""Judgement of a flight: its outcome, its errors, its objects, and what a lost drone did."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.simulation.flight import Flight, Progress, Touch, fly
from hitchopt.simulation.settings import Loss, Settings
from hitchopt.simulation.task import Task
from hitchopt.simulation.world import BODY_HALF_HEIGHT
from hitchopt.values import Array

STILL = 1e-6
"""Largest movement from one sample to the next of a vertex that is at rest [m], and largest change
of a tension that is steady, over the team's."""

TIGHT = 0.5
"""Least tension over the team's at which a vertex counts; a hitch that is being drawn tight has
ill-defined vertices."""

SAMPLE_SLACK, SAME_SAMPLE = 5.1e-3, 1e-5
"""Largest delay of a sample after its setpoint [s], which is taken at the first command after it;
and rounding of sample times [s]."""

HELD = 0.10
"""Largest movement under the pull test of a vertex that is held [m]."""

JUDGED = 1.0
"""Time over which places and forces are averaged before they are judged: the last second of the
rest, and of the pull test [s]."""

PLACED, TILTED = 0.03, 5.0
"""Largest distance [m] of an object from where the plan puts it down, and largest angle [°] to its
planned attitude."""

DROPPED = 0.05
"""Depth below its planned height from which on a carried object is dropped [m]."""

RELEASED = 0.2
"""Time at the end of the rest in which no cable may touch an object that is to be free [s]."""

SETTLED = 0.5
"""Time at the end of a flight over which it is judged where a lost drone hangs [s]."""

NO_FRICTION = (
    "friction is left at 0: at 0.1 hitches rest some 5 cm from their plans; "
    "state team.cable_friction, or give --friction"
)
"""Warning of a flight whose cables slide freely."""

SUCCEEDED, FAILED, NOT_SIMULATED = "succeeded", "failed", "not simulated"

START, INVALID = "start", "invalid"
UNSIMULATED = (START, INVALID)
"""Failures of the simulation itself: it could not begin, or left its valid range."""


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
        if not there.size:
            return cls()
        return cls(float(np.mean(there)), float(np.std(there)), float(np.max(there)))


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Errors of the vertices while the plan has a hitch, and until it has rested.

    Attributes
    ----------
    t: (samples,) [s]
    rows: samples of the flight's record (samples,).
    planned: planned vertices (samples, clasps, 3) [m].
    offsets: (samples, clasps, 3) [m], from the planned vertices; nan where cables do not bear on
        each other.
    moving: whether the plan moves any vertex or changes any tension (samples,): a hitch that is
        being drawn tight is not at rest yet.
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

    @property
    def lost(self) -> float:
        """Share of samples and vertices at which cables do not bear on each other."""
        return float(np.mean(np.isnan(self.errors))) if self.errors.size else 0.0


def vertex_errors(flight: Flight) -> VertexErrors:
    """Return the errors at the samples of a flight at which its plan has a hitch, drawn tight.

    The first sample does not count: no contact forces were gathered before it. After its end a plan
    stands still; the time of rest counts, the pull test does not.
    """
    task, record = flight.task, flight.record
    clasps, formed = task.team.layout.clasps, np.flatnonzero(task.formed)
    times, vertices = task.t[formed], task.vertices[formed]
    end = np.fmax(task.duration, flight.rested) + SAME_SAMPLE
    rows = np.flatnonzero((record.t > SAME_SAMPLE) & (record.t <= end))
    asked = task.t[0] + np.minimum(record.t[rows], task.duration)
    nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), asked)
    near = np.zeros(len(rows), dtype=np.bool_)
    if formed.size:
        near = np.abs(times[nearest] - asked) <= SAMPLE_SLACK
        near &= np.all(task.tensions[formed[nearest]] >= TIGHT * task.team.tension, axis=-1)
    rows, place = rows[near], nearest[near]
    step = np.zeros(len(formed))
    shifts = length(np.diff(vertices, axis=0))
    changes = np.abs(np.diff(task.tensions[formed], axis=0)) / task.team.tension
    step[1:] = np.max(np.concatenate([shifts, changes], axis=-1), axis=-1, initial=0.0)
    planned = vertices[place][:, clasps]
    moving = (step[place] > STILL) & (record.t[rows] <= task.duration + SAME_SAMPLE)
    return VertexErrors(record.t[rows], rows, planned, record.vertices[rows] - planned, moving)


def effective_lengths(flight: Flight) -> Array:
    """Return (n,) [m]: legs, edges and the arcs of their sag, between vertices at rest.

    It is how long the cables are for the hitch; nan where the flight did not rest in a hitch, or
    lost a drone.
    """
    record, team = flight.record, flight.task.team
    rows = (record.t > flight.task.duration + SAME_SAMPLE) & (record.t <= flight.rested)
    if not rows.any() or not flight.task.formed[-1] or flight.lost is not None:
        return np.full(team.robots, np.nan)
    layout, drones = team.layout, np.mean(record.drones[rows], axis=0)
    vertices = np.empty((layout.points, 3))
    vertices[layout.anchors] = drones  # a chain's ends; clasps follow
    vertices[layout.clasps] = np.mean(record.vertices[rows], axis=0)
    corners = drones[0::2], vertices[layout.starts], vertices[layout.ends], drones[1::2]
    chords = np.diff(np.stack(corners, axis=1), axis=1)
    sizes, level = length(chords), length(chords[..., :2])
    slack = GRAVITY * flight.density / np.mean(record.tensions[rows], axis=0)[:, None]
    found: Array = np.sum(sizes + slack**2 * sizes * level**2 / 24.0, axis=-1)
    return found


def tracking_errors(flight: Flight) -> Array:
    """Return (samples, 2n) [m]: distances of drones from their commands, until the flight's end."""
    record = flight.record
    during = record.t <= flight.task.duration + SAME_SAMPLE
    return length(record.drones[during] - record.commanded[during])


@dataclass(frozen=True)
class Failure:
    """One failure.

    Attributes
    ----------
    kind: one of UNSIMULATED, which say nothing about the plan, or ``touch``, ``unlinked``,
        ``tangled``, ``lost`` (cables that do not bear on each other), ``slipped`` (moved under the
        pull test); of objects ``dropped``, ``misplaced`` or ``caught`` (not free at the end).
    where: names of drones, cables, vertices or objects.
    time: [s], from the flight's start.
    words: description.
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
    linking: Gauss's linking number of its two cables, ±1 for a clasp. Cables that merely cross may
        have any of 0 and ±1: a clasp bears as well.
    bearing: contact force at rest [N].
    least_bearing: contact force from which on it bears [N].
    moved: movement under the pull test [m]; nan without one.
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
    tilted: angle of its axis from the vertical [°].
    turned: difference of its yaw from the plan's [°].
    lifted: mean height over the plan's while the hitch carries all of it [m]; nan if never.
    slipped: largest movement relative to the hitch while that carries all of it [m]; nan if never.
    dropped: time at which it was first DROPPED below its plan while carried [s]; nan if never.
    free: whether no cable touches it.
    round: whether it looks the same however it is turned, which is not judged then.
    """

    name: str
    placed: float
    tilted: float
    turned: float
    lifted: float
    slipped: float
    dropped: float
    free: bool
    round: bool = False

    @property
    def well_placed(self) -> bool:
        """Whether it is where the plan puts it, and upright."""
        turned = 0.0 if self.round else abs(self.turned)
        return self.placed <= PLACED and max(self.tilted, turned) <= TILTED


@dataclass(frozen=True)
class Outcome:
    """Outcome of a flight.

    Attributes
    ----------
    clasps: vertices of a plan that ends with a hitch, once it has rested; else none.
    failures: all failures, by time.
    objects: those that can move.
    """

    clasps: tuple[Clasp, ...]
    failures: tuple[Failure, ...]
    objects: tuple[ObjectState, ...] = ()

    @property
    def verdict(self) -> str:
        """SUCCEEDED, FAILED, or NOT_SIMULATED where nothing but the simulation failed."""
        if self.succeeded:
            return SUCCEEDED
        simulated = any(failure.kind not in UNSIMULATED for failure in self.failures)
        return FAILED if simulated else NOT_SIMULATED

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
    lost, names = flight.lost, set(flight.task.team.drone_names)
    survivors = names if lost is None else names - {lost.drone}
    failures = [
        Failure("touch", (e.first, e.second), e.time, f"{e.first} touches {e.second}")
        for e in flight.touches
        if lost is None or e.time < lost.time or {e.first, e.second} & survivors
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
    """Return the state of every vertex."""
    team, least = flight.task.team, flight.least_bearing
    layout = team.layout
    before, bearing = _means(flight, flight.rested)
    moved = length(_means(flight, flight.pulled)[0] - before)
    held = (moved <= HELD) | np.isnan(flight.pulled)  # without a pull test both are nan
    linking = links[layout.behind, layout.ahead]
    bears = (bearing >= least) & (least > 0.0)
    holds = (np.abs(linking) == 1) & bears & held & (flight.error is None)
    names = [team.point_names[point] for point in layout.clasps]
    columns = (column.tolist() for column in (linking, bearing, least, moved, holds, bears))
    return tuple(Clasp(*values) for values in zip(names, *columns, strict=True))


def _means(flight: Flight, end: float) -> tuple[Array, Array]:
    """Return mean vertices and contact forces over the last JUDGED seconds until ``end`` [s]."""
    record = flight.record
    chosen = (record.t > end - JUDGED) & (record.t <= end + 1e-9)
    vertices, bearing = record.vertices[chosen], record.bearing[chosen]
    count = np.sum(np.isfinite(vertices[..., :1]), axis=0)
    sums = np.nansum(vertices, axis=0)
    places: Array = np.divide(sums, count, out=np.full_like(sums, np.nan), where=count > 0)
    forces: Array = np.sum(bearing, axis=0) / max(len(bearing), 1)
    return places, forces


def _loose(flight: Flight, linking: NDArray[np.int64], clasps: tuple[Clasp, ...]) -> list[Failure]:
    """Return cables that are not linked as the plan's end requires, and clasps that do not hold."""
    at = {}  # the name of the vertex where a pair of cables is to be linked
    if flight.task.formed[-1]:
        layout, names = flight.task.team.layout, flight.task.team.point_names
        pairs = zip(layout.behind.tolist(), layout.ahead.tolist(), strict=True)
        at = {frozenset(pair): names[p] for pair, p in zip(pairs, layout.clasps, strict=True)}
    failures = []
    for i, j in np.argwhere(np.triu(np.ones_like(linking), 1)).tolist():
        name, words = at.get(frozenset((i, j))), f"cables {i} and {j} are linked {linking[i, j]}"
        if name is not None and abs(linking[i, j]) != 1:
            told = f"{name}: {words} times, not once"
            failures.append(Failure("unlinked", (name,), flight.rested, told))
        elif name is None and linking[i, j]:
            where, told = (f"cable {i}", f"cable {j}"), f"{words} times, and should not be"
            failures.append(Failure("tangled", where, flight.rested, told))
    for clasp in clasps:
        if abs(clasp.linking) == 1 and not clasp.bears:
            words = (
                f"{clasp.name}: its cables press with {clasp.bearing:.3f} N, less than the "
                f"{clasp.least_bearing:.3f} N from which on a clasp bears: they merely cross"
            )
            failures.append(Failure("lost", (clasp.name,), flight.rested, words))
        elif abs(clasp.linking) == 1 and clasp.moved > HELD:
            words = f"{clasp.name}: moves {clasp.moved:.3f} m under the pull test, more than {HELD}"
            failures.append(Failure("slipped", (clasp.name,), flight.pulled, f"{words} m"))
    return failures


def _mishandled(flight: Flight, state: ObjectState) -> list[Failure]:
    """Return what went wrong with an object."""
    name, found = state.name, []
    if np.isfinite(state.dropped):
        words = f"{name} is dropped: more than {100 * DROPPED:g} cm below its planned height"
        found.append(Failure("dropped", (name,), state.dropped, words))
    if flight.linking is None:  # the flight never ended
        return found
    if not state.well_placed:
        words = (
            f"{name} is {100 * state.placed:.1f} cm from its place, tilted by {state.tilted:.1f}°, "
            f"turned by {state.turned:.1f}°; at most {100 * PLACED:g} cm and {TILTED:g}°"
        )
        found.append(Failure("misplaced", (name,), flight.rested, words))
    cargo = flight.task.cargo
    if not (state.free or cargo.held[-1, cargo.names.index(name)]):
        found.append(Failure("caught", (name,), flight.rested, f"{name}: cables touch it still"))
    return found


def object_states(flight: Flight) -> tuple[ObjectState, ...]:
    """Return the states of all objects that can move, at the end of the rest or of the record."""
    task, record, cargo = flight.task, flight.record, flight.task.cargo
    if not cargo.movable.any():
        return ()
    rested = bool(np.isfinite(flight.rested))
    end = flight.rested if rested else record.t[-1]
    t = record.t[: np.searchsorted(record.t, end + 1e-9, side="right")]
    rows = np.array([task.index(at) for at in t], dtype=np.intp)
    poses, plan = record.poses[: len(t)], cargo.poses[rows]
    offsets = poses[..., :3] - plan[..., :3]
    clasps = task.team.layout.clasps
    hitch = np.mean(record.vertices[: len(t)] - task.vertices[rows][:, clasps], axis=1)
    resting = t > end - JUDGED if rested else t == end
    found = []
    for i in np.flatnonzero(cargo.movable):
        carried, body = cargo.carried[rows, i], cargo.objects[cargo.names[i]]
        axes = Rotation.from_quat(poses[resting, i, 3:], scalar_first=True).mean().as_matrix()
        yaw = np.arctan2(axes[1, 0], axes[0, 0]) - np.arctan2(plan[-1, i, 4], plan[-1, i, 3])
        low = np.flatnonzero(carried & (offsets[:, i, 2] < -DROPPED))
        sections = [body.section] if body.rim is None else [body.section, body.rim.section]
        found.append(
            ObjectState(
                cargo.names[i],
                placed=float(length(np.mean(offsets[resting, i], axis=0))),
                tilted=float(np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0)))),
                turned=float(np.degrees(np.arctan2(np.sin(yaw), np.cos(yaw)))),
                lifted=float(np.mean(offsets[carried, i, 2])) if carried.any() else np.nan,
                slipped=_slipped(offsets[:, i] - hitch, carried),
                dropped=float(t[low[0]]) if low.size else np.nan,
                free=not bool(record.touched[: len(t)][t > end - RELEASED, i].any()),
                round=all(each.radius is not None for each in sections),
            )
        )
    return tuple(found)


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
    """What became of a team after a loss, in a simulated flight.

    Attributes
    ----------
    drone, time: the loss.
    among: contacts of two survivors.
    others: contacts of survivors with cables or with the lost drone.
    peak_tension: largest tension of any cable from the loss on [N].
    peak_thrust: largest thrust of a survivor from the loss on [N].
    moved: largest distance of a survivor from its setpoint from the loss on [m].
    dropped: height by which the lost drone is lower at the end than when it was lost [m].
    hangs: its mean height over the ground at the end [m]; 0.005 m and less where it lies there.
    linked: clasps whose cables are linked at the end, by name.
    """

    drone: str
    time: float
    among: tuple[Touch, ...]
    others: tuple[Touch, ...]
    peak_tension: float
    peak_thrust: float
    moved: float
    dropped: float
    hangs: float
    linked: tuple[str, ...]

    @property
    def apart(self) -> bool:
        """Whether no two survivors touch."""
        return not self.among


def loss_outcome(flight: Flight, loss: Loss) -> LossOutcome:
    """Return what became of a flight's team after a loss."""
    record, team = flight.record, flight.task.team
    lost = team.drone_names.index(loss.drone)
    after = record.t >= loss.time - 1e-9
    after[-1] = True
    survivors = np.arange(team.drones) != lost
    names = set(team.drone_names) - {loss.drone}
    late = [e for e in flight.touches if e.time >= loss.time - 1e-9 and {e.first, e.second} & names]
    heights = record.drones[:, lost, 2]
    end = heights[record.t > record.t[-1] - SETTLED]
    linked: tuple[str, ...] = ()
    if flight.linking is not None:
        layout = team.layout
        found = np.abs(flight.linking[layout.behind, layout.ahead]) == 1
        linked = tuple(team.point_names[point] for point in layout.clasps[found])
    return LossOutcome(
        loss.drone,
        loss.time,
        tuple(e for e in late if {e.first, e.second} <= names),
        tuple(e for e in late if not {e.first, e.second} <= names),
        float(np.max(record.peak_tensions[after])),
        float(np.max(record.thrusts[after][:, survivors])),
        float(np.max(length(record.drones - record.commanded)[after][:, survivors])),
        float(heights[np.flatnonzero(after)[0]] - end[-1]),
        float(np.mean(end)) - flight.ground - BODY_HALF_HEIGHT,
        linked,
    )


@dataclass(frozen=True)
class Run(OneLine):
    """Figures of one flight; nan where it could not begin.

    Attributes
    ----------
    seed: of its perturbations; the same seed gives the same flight.
    verdict: that of its Outcome.
    failures: all failures, by time.
    vertex_error: distances of vertices from the plan's in three dimensions, sag included, over
        vertices and time [m].
    resting, moving: the same while the plan stands still, and while it moves a vertex; nan where it
        does not.
    without_sag: level part of vertex_error [m].
    tracking: distances of drones from their commands [m].
    peak_tension, peak_thrust: [N]
    saturated: share of samples at which a drone's command exceeded its thrust.
    pace: simulated seconds per second of one processor.
    placed, tilted, slipped: largest of the objects' distances from their places at the end [m],
        angles from the vertical [°], and movements relative to the hitch that carries them [m].
    """

    seed: int
    verdict: str
    failures: tuple[Failure, ...]
    vertex_error: Spread = Spread()
    resting: Spread = Spread()
    moving: Spread = Spread()
    without_sag: Spread = Spread()
    tracking: Spread = Spread()
    peak_tension: float = np.nan
    peak_thrust: float = np.nan
    saturated: float = np.nan
    pace: float = np.nan
    placed: float = np.nan
    tilted: float = np.nan
    slipped: float = np.nan

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.verdict == SUCCEEDED

    @property
    def figures(self) -> dict[str, float]:
        """All figures but the pace by name, such as ``tracking_mean``."""
        found: dict[str, float] = {}
        for name, value in vars(self).items():
            if isinstance(value, Spread):
                found |= {f"{name}_{key}": each for key, each in vars(value).items()}
            elif isinstance(value, float) and name != "pace":
                found[name] = value
        return found


@dataclass(frozen=True, eq=False)
class Simulation(OneLine):
    """A flight, its outcome and its settings.

    Attributes
    ----------
    settings: settings of the simulation.
    flight: records of the flight.
    outcome: whether it succeeded.
    errors: of its vertices.
    processor: processor time [s].
    """

    settings: Settings
    flight: Flight
    outcome: Outcome
    errors: VertexErrors
    processor: float

    @property
    def loss(self) -> LossOutcome | None:
        """What became of the others after the loss of a drone; None where none was lost."""
        lost = self.flight.lost
        return None if lost is None else loss_outcome(self.flight, lost)

    @property
    def run(self) -> Run:
        """Figures of the flight."""
        record, errors, times = self.flight.record, self.errors, self.flight.film.t
        simulated = float(times[-1] - times[0]) if len(times) else 0.0  # settling included
        worst = {
            name: float(np.fmax.reduce([np.nan, *(getattr(o, name) for o in self.outcome.objects)]))
            for name in ("placed", "tilted", "slipped")
        }
        return Run(
            self.settings.seed,
            self.outcome.verdict,
            self.outcome.failures,
            Spread.of(errors.errors),
            Spread.of(errors.errors[~errors.moving]),
            Spread.of(errors.errors[errors.moving]),
            Spread.of(errors.without_sag),
            Spread.of(tracking_errors(self.flight)),
            float(np.max(record.peak_tensions)),
            float(np.max(record.thrusts)),
            float(np.mean(record.saturated)),
            simulated / max(self.processor, 1e-9),
            **worst,
        )


def warnings(task: Task, settings: Settings) -> tuple[str, ...]:
    """Return what the user should know of a flight's conditions: friction that is left at 0."""
    return (NO_FRICTION,) if settings.friction is None and not task.team.cable_friction else ()


def simulate(task: Task, settings: Settings, progress: Progress | None = None) -> Simulation:
    """Return the judged flight of a task.

    Parameters
    ----------
    task: setpoints and planned hitch.
    settings: settings of the simulation.
    progress: called repeatedly with a description of the current work.

    Raises
    ------
    InputError: a preset that cannot bear the team's tension, or an unstable position loop.
    ShapeError: cables that cannot hang between the first setpoints.
    UnsupportedError: mujoco is not installed.
    """
    begin = time.process_time()
    flight = fly(task, settings, progress)
    processor = time.process_time() - begin
    return Simulation(settings, flight, judge(flight), vertex_errors(flight), processor)
