"""Evaluation of a simulated flight: outcome, errors, objects, and the loss of a drone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from hitchopt.drones.controllers import Tube
from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import length
from hitchopt.hitch.losses import displacements
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import Layout
from hitchopt.lab.simulation.commands import named_controllers
from hitchopt.lab.simulation.contacts import least_bearing
from hitchopt.lab.simulation.departures import Failure, departures
from hitchopt.lab.simulation.planned_rests import (
    REST_TIME,
    resting_samples,
)
from hitchopt.lab.simulation.record import SimulatedFlight, ground_of
from hitchopt.lab.simulation.ropes import largest_tension, simulated_density
from hitchopt.lab.simulation.settings import CLASPS, Loss, Settings
from hitchopt.lab.simulation.task import RATE, Task, closed_spans, team_of
from hitchopt.lab.simulation.world import BODY_HALF_HEIGHT
from hitchopt.motion.states import TAUT_RATIO
from hitchopt.values import Array

ROUNDING = 1e-5  # Rounding error of sample times [s]
MAX_SLIP = 0.10  # Largest slip of a vertex along its cables in the pull test [m]

# Largest distance of an object from its planned position, beyond the plan's tracking errors [m]
MAX_DISTANCE = 0.03
MAX_ANGLE = 5.0  # Largest angle of an object from its planned attitude [°]

# Largest depth of a carried object below its planned height, beyond the tracking errors [m]
MAX_DROP = 0.05
RELEASE_TIME = 0.2  # Final time of the rest in which no cable may touch a free object [s]
AVERAGE_TIME = 0.2  # Averaging time of tensions [s]
TAUT_AGAIN = (
    0.8  # Smallest tension of a chain that is taut again after a loss, over the planned one
)
HANG_TIME = 0.5  # Final time of a flight over which the height of a lost drone is averaged [s]

# Warnings about cables without friction; about weightless ones, with the density of their ropes
# [g/m] and the preset; about different controllers; and about drones that are not simulated
NO_FRICTION = (
    "friction is assumed to be 0; with a coefficient of 0.1, vertices end about 5 cm off: "
)
NO_FRICTION += "state team.cable_friction, or perturb friction"
WEIGHTLESS = (
    "cables are weightless in the plan, and fly as ropes of {:.2g} g/m, the lightest that {} "
)
WEIGHTLESS += "can simulate: state team.cable_density, or perturb density"
HITCHED = (
    "only the tied hitch is simulated (t = {}), without contacts of drones, cables and objects: "
    "cables=ropes simulates the rest"
)
SEVERAL = "controllers are replaced by the ideal one; choose another with controller="
NOT_FLOWN = (
    "only hitches are simulated: these drones follow their setpoints exactly, without cables"
)

SUCCEEDED = "succeeded"  # Verdict of a flight that holds
FAILED = "failed"  # Verdict of a flight that does not hold
NOT_SIMULATED = "not simulated"  # Verdict of a flight that leaves the simulation's valid range

# Failures of the simulation itself: at its start, or by leaving its valid range
UNSIMULATED = START, INVALID = "start", "invalid"


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation and largest value of errors; nan without errors."""

    mean: float = np.nan
    deviation: float = np.nan
    largest: float = np.nan

    @classmethod
    def of(cls, errors: Array) -> Spread:
        """Return the spread of finite errors."""
        finite = errors[np.isfinite(errors)]
        measures = (np.mean, np.std, np.max) if finite.size else ()
        return cls(*(float(measure(finite)) for measure in measures))


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Errors of the vertices while the plan has a taut hitch, until the end of the rest."""

    t: Array  # times (samples,) [s]
    rows: NDArray[np.intp]  # indices into the flight's record (samples,)
    # planned vertices (samples, clasps, 3) [m]; nan if the team's hitch is not taut
    planned: Array
    offsets: Array  # from planned vertices (samples, clasps, 3) [m]; nan if cables do not bear
    moving: NDArray[np.bool_]  # whether the plan moves any vertex or changes any tension (samples,)

    @property
    def errors(self) -> Array:
        """Distances in three dimensions, sag included (samples, clasps) [m]."""
        return length(self.offsets)

    @property
    def without_sag(self) -> Array:
        """Horizontal distances (samples, clasps) [m]."""
        return length(self.offsets[..., :2])


def vertex_errors(flight: SimulatedFlight) -> VertexErrors:
    """Return the errors at the samples of a flight, without the pull test.

    The first sample is excluded, since no contact forces precede it, and so are those after the
    loss of a robot.
    """
    task, record = flight.task, flight.record
    taut, moves = list[NDArray[np.bool_]](), np.zeros(len(task.states.t), np.bool_)
    for part in task.teams:
        formed = part.states.formed
        taut.append(part.states.taut(part.team.tension))
        moves[1:] |= ~resting_samples(part)[1:] & formed[1:] & formed[:-1]
    clasp_is_taut = task.clasped(taut)
    end = np.fmax(task.duration, flight.rested) + ROUNDING
    if (lost := flight.settings.lost) is not None:
        end = min(end, lost.time)
    rows = np.flatnonzero(
        (record.t > ROUNDING) & (record.t <= end) & clasp_is_taut[record.index].any(axis=-1)
    )
    t, index = record.t[rows], record.index[rows]
    planned = task.states.vertices[index][:, task.team.layout.clasps]
    planned = np.where(clasp_is_taut[index, :, None], planned, np.nan)
    moving = moves[index] & (t <= task.duration + ROUNDING)
    return VertexErrors(t, rows, planned, record.vertices[rows] - planned, moving)


def tension_ratios(flight: SimulatedFlight, rows: NDArray[np.int64]) -> Array:
    """Return tensions over the planned ones at rows of the record (rows, n), nan while slack."""
    task, index = flight.task, flight.record.index[rows]
    planned = task.states.tensions[index]
    planned = np.where(planned >= TAUT_RATIO * task.team.tension, planned, np.nan)
    return np.asarray(flight.record.tensions[rows] / planned)


def tracking_verdict(flight: SimulatedFlight) -> str:
    """Return in words the largest errors of drones, and what the plan allows for; empty without.

    Errors are distances from the planned positions, horizontal and vertical; drones that are
    lost have none.
    """
    record, tube, task = flight.record, allowed_errors(flight), flight.task
    during = record.t <= task.duration + ROUNDING
    errors = record.drones[during] - task.states.positions[record.index[during]]
    errors = errors[:, _flying(flight)]
    if task.flight is None or errors.size == 0:
        return ""
    level, upright = np.hypot(errors[..., 0], errors[..., 1]), np.abs(errors[..., 2])
    largest = f"{np.max(level):.3g} m horizontally, {np.max(upright):.3g} m vertically"
    if tube.level == 0.0:
        return (
            f"drones were off by up to {largest}; the plan allows for no errors (limits.tracking)"
        )
    state = "within" if tube.contains(errors) else "more than"
    return f"drones were off by up to {largest}, {state} limits.tracking ({tube})"


def tracking_errors(flight: SimulatedFlight) -> Array:
    """Return distances of drones from their setpoints during the plan (samples, drones) [m].

    They are those of all drones, or of those that survive.
    """
    record = flight.record
    during = record.t <= flight.task.duration + ROUNDING
    return length(record.drones[during] - record.commanded[during])[:, _flying(flight)]


def _flying(flight: SimulatedFlight) -> NDArray[np.bool_]:
    """Return whether drones (2n,) fly to the end; False for those that are lost."""
    lost = flight.settings.lost
    names = np.array(flight.task.team.drone_names)
    return ~np.isin(names, () if lost is None else lost.drones)


@dataclass(frozen=True)
class ClaspState:
    """State of one vertex at the end of a flight."""

    name: str  # p0, p1, …
    linking: int  # Gauss's linking number of its two cables; ±1 for a clasp
    bearing: float  # contact force at rest [N]
    # its smallest value for a clasp [N]; cables that only cross may also be linked
    least_bearing: float
    # slip along its cables in the pull test [m], the larger change of its two leg lengths, which
    # excludes drift of soft drones; nan without a pull test
    moved: float
    holds: bool  # whether it is linked once, bears and does not slip
    bears: bool  # whether its cables press on each other as in a clasp


@dataclass(frozen=True)
class ObjectState:
    """State of one object at rest, and its motion while it was held."""

    name: str  # of the object
    placed: float  # distance of its base from the plan's [m]
    beyond: float  # distance of its base from where the plan's tracking errors may take it [m]
    tilted: float  # angle of its axis from the vertical [°]
    turned: float  # angle of its yaw from the plan's [°]
    # largest motion of the hitch's middle on it while fully carried [m]; nan if never carried
    slipped: float
    # first time at which it was more than MAX_DROP below its plan while carried [s], or nan
    dropped: float
    free: bool  # whether no cable touches it
    round: bool  # whether it is rotationally symmetric

    @property
    def well_placed(self) -> bool:
        """Return whether position and attitude agree with the plan."""
        turned = 0.0 if self.round else abs(self.turned)
        return self.beyond <= MAX_DISTANCE and max(self.tilted, turned) <= MAX_ANGLE


@dataclass(frozen=True)
class Outcome:
    """Failures by time, movable objects, and the vertices at the end of the plan."""

    clasps: tuple[ClaspState, ...]
    failures: tuple[Failure, ...]
    objects: tuple[ObjectState, ...] = ()

    @property
    def verdict(self) -> str:
        """SUCCEEDED, FAILED, or NOT_SIMULATED if only the simulation failed."""
        simulated = any(failure.kind not in UNSIMULATED for failure in self.failures)
        return FAILED if simulated else NOT_SIMULATED if self.failures else SUCCEEDED

    @property
    def succeeded(self) -> bool:
        """Return whether there are no failures."""
        return not self.failures

    @property
    def hitched(self) -> bool:
        """Return whether there are vertices and all of them hold."""
        return bool(self.clasps) and all(clasp.holds for clasp in self.clasps)


def judge(flight: SimulatedFlight) -> Outcome:
    """Return the outcome of a flight.

    If the plan ends with a hitch, every vertex must hold; otherwise cables must not be linked. The
    same applies where the plan stops for a pull test.
    Drones and cables must stay within what the plan was certified for (see ``departures``).
    Objects must be at their planned positions, and free unless the plan ends holding them. After
    the loss of a robot only contacts of survivors are failures, except with its cable.
    """
    lost, names = flight.settings.lost, set(flight.task.team.drone_names)
    failures = [
        Failure("touch", pair, time, " touches ".join(pair))
        for pair, time in flight.touches.items()
        if lost is None or time < lost.time or _is_failure(pair, lost, names)
    ]
    failures += departures(flight)
    if (error := flight.error) is not None:
        failures.append(Failure(INVALID, (error.where,), error.time, str(error)))
    clasps: tuple[ClaspState, ...] = ()
    objects: tuple[ObjectState, ...] = ()
    if lost is None:
        if flight.linking is not None:
            clasps = tuple(vertices_of(flight).values())
            failures += _failed_links(flight, flight.linking, clasps)
        for time, test in flight.pull_tests.items():
            failures += _failures_in_test(test, time)
        objects = object_states(flight)
        failures += [failure for each in objects for failure in _object_failures(flight, each)]
    return Outcome(clasps, tuple(sorted(failures, key=lambda failure: failure.time)), objects)


def _is_failure(pair: tuple[str, str], lost: Loss, drones: set[str]) -> bool:
    """Return whether a contact after a loss is one of survivors, not with what falls."""
    return bool({*pair} & (drones - {*lost.drones})) and lost.cable not in pair


def clasp_links(links: NDArray[np.int64], layout: Layout) -> NDArray[np.int64]:
    """Return the linking number of each clasp (clasps,), ±1 if it holds.

    ``links`` (n, n) are those of all cables.
    """
    return links[layout.behind, layout.ahead]


def vertices_of(flight: SimulatedFlight) -> dict[str, ClaspState]:
    """Return the vertices at the end of a flight's plan by name; none if it ended before."""
    if flight.linking is None or not flight.task.states.formed[-1]:
        return {}
    return {clasp.name: clasp for clasp in _clasps(flight, flight.linking)}


def _clasps(flight: SimulatedFlight, links: NDArray[np.int64]) -> tuple[ClaspState, ...]:
    """Return the state of every vertex at the end of the plan."""
    team, layout = flight.task.team, flight.task.team.layout
    hitched = flight.task.last_clasps
    legs_before, bearing = _means(flight, flight.rested)
    moved = np.max(np.abs(_means(flight, flight.pulled)[0] - legs_before), axis=-1)
    stays = (moved <= MAX_SLIP) | np.isnan(flight.pulled)  # both are nan without a pull test
    linking, least = clasp_links(links, layout), least_bearing(flight.task)[-1]
    bears = (bearing >= least) & (least > 0.0)
    holds = (np.abs(linking) == 1) & bears & stays & (flight.error is None)
    names = [team.point_names[point] for point in layout.clasps]
    columns = (column.tolist() for column in (linking, bearing, least, moved, holds, bears))
    each = zip(names, *columns, strict=True)
    return tuple(
        ClaspState(*values) for values, exists in zip(each, hitched, strict=True) if exists
    )


def _means(flight: SimulatedFlight, end: float) -> tuple[Array, Array]:
    """Return mean leg lengths (clasps, 2) [m] and contact forces (clasps,) [N] before ``end`` [s].

    Means are over the last REST_TIME; leg lengths are nan without vertices.
    """
    record = flight.record
    layout = flight.task.team.layout
    chosen = (record.t > end - REST_TIME) & (record.t <= end + ROUNDING)
    drones_of_clasps = np.stack([2 * layout.ahead, 2 * layout.behind + 1], axis=-1)  # q, r
    drones = record.drones[chosen][:, drones_of_clasps]  # (samples, clasps, 2, 3)
    legs = length(drones - record.vertices[chosen][:, :, None])
    sums = np.nansum(legs, axis=0)
    counts = np.sum(np.isfinite(legs), axis=0)
    mean_legs: Array = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
    bearing = record.bearing[chosen]
    mean_bearing = np.sum(bearing, axis=0) / max(len(bearing), 1)
    return mean_legs, mean_bearing


def _failed_links(
    flight: SimulatedFlight, linking: NDArray[np.int64], clasps: tuple[ClaspState, ...]
) -> list[Failure]:
    """Return failures of cables that should not be linked, and of clasps that do not hold."""
    task, layout, rested, failures = flight.task, flight.task.team.layout, flight.rested, []
    unexpected = np.triu(linking, 1)
    formed = task.clasped([part.states.formed[-1] for part in task.teams])
    ahead, behind = layout.ahead[formed], layout.behind[formed]
    unexpected[behind, ahead] = unexpected[ahead, behind] = 0
    for i, j in np.argwhere(unexpected).tolist():
        one, other = cables = (flight.cable_names[i], flight.cable_names[j])
        words = f"{one} and {other} are linked {linking[i, j]} times, but should be free"
        failures.append(Failure("tangled", cables, rested, words))
    # Straight cables that lie on each other may be linked or not, but hardly press.
    bearing = _means(flight, rested)[1]
    presses = bearing >= least_bearing(task)[-1]
    for c in np.flatnonzero(formed & ~task.last_clasps & presses).tolist():
        name = task.team.point_names[layout.clasps[c]]
        words = f"{name} is closed (contact force {bearing[c]:.3f} N), but should be open"
        failures.append(Failure("tangled", (name,), rested, words))
    for each in clasps:
        force, least, moved = f"{each.bearing:.3f} N", f"{each.least_bearing:.3f} N", each.moved
        cases = (  # the first one is reported
            (abs(each.linking) != 1, "unlinked", f"is linked {each.linking} times, not once"),
            (
                not each.bears,
                "lost",
                f"contact force {force}, below {least}: cables only cross",
            ),
            (
                moved > MAX_SLIP,
                "slipped",
                f"slips {moved:.3f} m in the pull test; at most {MAX_SLIP} m",
            ),
        )
        for kind, words in [case for wrong, *case in cases if wrong][:1]:
            when = flight.pulled if kind == "slipped" else rested
            failures.append(Failure(kind, (each.name,), when, f"{each.name} {words}"))
    return failures


def _failures_in_test(test: SimulatedFlight, time: float) -> list[Failure]:
    """Return the failures of links in a pull test at a time [s]; none if it is not valid."""
    if test.error is not None or test.linking is None:
        return []
    failures = _failed_links(test, test.linking, tuple(vertices_of(test).values()))
    words = f"at rest at t = {time:.2f} s"
    return [replace(each, time=time, words=f"{each.words}, {words}") for each in failures]


def _object_failures(flight: SimulatedFlight, state: ObjectState) -> list[Failure]:
    """Return the failures of an object."""
    cargo, ended, rested = flight.task.cargo, flight.linking is not None, flight.rested
    held, dropped = cargo.held[-1, cargo.names.index(state.name)], bool(np.isfinite(state.dropped))
    error = (
        f" is {100 * state.placed:.1f} cm from its plan, tilted by {state.tilted:.1f}°, turned by "
        f"{state.turned:.1f}°; at most {100 * MAX_DISTANCE:g} cm and {MAX_ANGLE:g}°"
    )
    drop = f" was dropped: more than {100 * MAX_DROP:g} cm below its planned height"
    if (tube := allowed_errors(flight)).level:
        error, drop = (f"{words}, beyond tracking errors of {tube}" for words in (error, drop))
    cases = (
        (dropped, "dropped", state.dropped, drop),
        (ended and not state.well_placed, "misplaced", rested, error),
        (ended and not (state.free or held), "caught", rested, ": cables still touch it"),
    )
    return [
        Failure(kind, (state.name,), when, state.name + words)
        for wrong, kind, when, words in cases
        if wrong
    ]


def allowed_errors(flight: SimulatedFlight) -> Tube:
    """Return the largest tracking errors of any team that the plan allows for.

    Distances of a carried object are certified for position errors of it as large as those of the
    drones (see ``hitchopt.checks.tracking``): a ring of displaced drones is next to its planned
    position, and so is the object that it sets down.
    """
    planned = flight.task.flight
    teams = () if planned is None else planned.teams
    tubes = [each.motion.requirements.limits.tube for each in teams]
    return Tube.enclosing(tubes) or Tube.of(None)


def object_states(
    flight: SimulatedFlight, end: float | None = None, window: float = REST_TIME
) -> tuple[ObjectState, ...]:
    """Return the states of all movable objects at a time [s]: means over a ``window`` [s] before.

    Without a time it is the end of the rest, or the last sample of a record that ends before.
    """
    task, record, cargo = flight.task, flight.record, flight.task.cargo
    if not cargo.movable.any():
        return ()
    if end is None:
        rested = bool(np.isfinite(flight.rested))
        end, window = (flight.rested, window) if rested else (float(record.t[-1]), 2.0 * ROUNDING)
    t = record.t[record.t <= end + ROUNDING]
    rows, poses, touched = (x[: len(t)] for x in (record.index, record.poses, record.touched))
    plan, at_end = cargo.poses[rows], t > end - window
    yaws, tube = np.arctan2(plan[-1, :, 4], plan[-1, :, 3]), allowed_errors(flight)
    offsets = poses[..., :3] - plan[..., :3]
    vertices, states = record.vertices[: len(t)], list[ObjectState]()
    teams = np.array([team_of(task.team.point_names[p]) for p in task.team.layout.clasps])
    for i in np.flatnonzero(cargo.movable):
        name, carried = cargo.names[i], cargo.carried[rows, i]
        hitch = np.mean(vertices[:, teams == cargo.holders.get(name, "")], axis=1)
        attitudes = Rotation.from_quat(poses[:, i, 3:], scalar_first=True)
        middles = attitudes.apply(hitch - poses[:, i, :3], inverse=True)
        turned = Rotation.from_quat(poses[at_end, i, 3:], scalar_first=True).mean()
        axes = (Rotation.from_euler("z", -yaws[i]) * turned).as_matrix()
        dropped_times = t[carried & (offsets[:, i, 2] < -MAX_DROP - tube.largest)]
        off = np.mean(offsets[at_end, i], axis=0)
        # Vertical errors do not move objects that stand.
        allowed = tube.level, tube.largest if cargo.held[rows[-1], i] else 0.0
        excess = np.maximum([length(off[:2]) - allowed[0], abs(off[2]) - allowed[1]], 0.0)
        states.append(
            ObjectState(
                name,
                placed=float(length(off)),
                beyond=float(length(excess)),
                tilted=float(np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0)))),
                turned=float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))),
                slipped=_slipped(middles, carried),
                dropped=float(np.min(dropped_times)) if dropped_times.size else np.nan,
                free=not touched[t > end - RELEASE_TIME, i].any(),
                round=all(slab.section.radius is not None for slab in cargo.objects[name].slabs),
            )
        )
    return tuple(states)


def _slipped(middles: Array, carried: NDArray[np.bool_]) -> float:
    """Return the largest motion of a hitch's middle on an object since it was lifted [m].

    ``middles`` (samples, 3) [m] are in the object's frame, in which tilting and swinging move no
    point; nan without a hitch.
    """
    chosen = np.flatnonzero(carried & np.isfinite(middles[:, 0]))
    runs = np.split(chosen, np.flatnonzero(np.diff(np.cumsum(~carried)[chosen])) + 1)
    slips = [float(np.max(length(middles[run] - middles[run[0]]))) for run in runs if len(run)]
    return max(slips, default=np.nan)


@dataclass(frozen=True)
class LossOutcome(OneLine):
    """Outcome for a team after the loss of a robot at a time [s]."""

    lost: str
    time: float
    among: tuple[tuple[str, str], ...]  # contacts of two survivors
    others: tuple[tuple[str, str], ...]  # contacts of survivors with cables or lost drones
    peak_tension: float  # largest tension of a cable since the loss [N]
    moved: float  # largest distance of a survivor from its setpoint since the loss [m]
    # largest distance of a survivor from where it was beside its setpoint at the loss [m]
    displaced: float
    bound: float  # what a cut displaces at most, ``loss_displacement`` [m]
    # mean height of what is lost above the ground at the end [m]; about 0 if it lies
    hangs: float
    linked: tuple[str, ...]  # names of clasps whose cables are linked at the end
    # time from which all remaining cables are under tension again [s], after the loss; nan if never
    taut_after: float

    @property
    def collision_free(self) -> bool:
        """Return whether no two survivors touch."""
        return not self.among


def loss_outcome(flight: SimulatedFlight) -> LossOutcome | None:
    """Return the outcome for a flight's team after the loss of a robot; None without one."""
    record, team, loss = flight.record, flight.task.team, flight.settings.lost
    if loss is None:
        return None
    after = record.t >= min(loss.time - 1e-9, record.t[-1])
    survivors = _flying(flight)
    errors = (record.drones - record.commanded)[after][:, survivors]
    names = set(team.drone_names) - {*loss.drones}
    late = [p for p, t in flight.touches.items() if t >= loss.time - 1e-9 and set(p) & names]
    end = record.drones[record.t > record.t[-1] - HANG_TIME][:, ~survivors, 2]
    layout, linked = team.layout, np.zeros(0, dtype=np.intp)
    if flight.linking is not None:
        linked = layout.clasps[np.abs(clasp_links(flight.linking, layout)) == 1]
    return LossOutcome(
        loss.name,
        loss.time,
        tuple(pair for pair in late if set(pair) <= names),
        tuple(pair for pair in late if not set(pair) <= names),
        float(np.max(record.peak_tensions[after])),
        float(np.max(length(errors))),
        float(np.max(length(errors - errors[0]))),
        float(np.max(displacements(team)[survivors])),
        float(np.mean(end)) - ground_of(flight.task) - BODY_HALF_HEIGHT,
        tuple(team.point_names[point] for point in linked),
        _taut_after(flight, loss, survivors[::2]),
    )


def _taut_after(flight: SimulatedFlight, loss: Loss, remaining: NDArray[np.bool_]) -> float:
    """Return the time [s] after a loss from which the remaining cables (n,) are taut for good.

    Their tensions, means over AVERAGE_TIME, are then at least TAUT_AGAIN of the planned ones at the
    end.
    """
    record = flight.record
    planned = flight.task.states.tensions[-1, remaining]
    tensions = uniform_filter1d(record.tensions[:, remaining], round(AVERAGE_TIME * RATE), axis=0)
    slack = np.any(tensions < TAUT_AGAIN * planned, axis=1) & (record.t > loss.time)
    last = int(np.max(np.flatnonzero(slack), initial=0))
    if not np.all(planned > 0.0) or last + 1 >= len(record.t):
        return np.nan
    return max(0.0, float(record.t[last + 1]) - loss.time)


@dataclass(frozen=True)
class CampaignRun(OneLine):
    """Row of a campaign for one flight: seed, verdict, failures by time, and figures by name.

    ``rests`` has the mean errors [m] of vertices at each rest, by rest and by vertex. A flight that
    failed at its start has no figures. Flights are reproducible by their seeds.
    """

    seed: int
    verdict: str
    failures: tuple[Failure, ...]
    figures: dict[str, float]
    rests: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def succeeded(self) -> bool:
        """Return whether there are no failures."""
        return self.verdict == SUCCEEDED


class Closest(NamedTuple):
    """The two closest drones by name, their distance, and its time [s]."""

    drones: tuple[str, str]
    distance: float
    time: float


def separation_of(flight: SimulatedFlight) -> Separation:
    """Return the separation that a plan keeps; the default for other setpoints."""
    planned = flight.task.flight
    return Separation() if planned is None else planned.requirements.separation


def closest(flight: SimulatedFlight, scale: ArrayLike = 1.0) -> Closest:
    """Return the closest drones before the pull test, in distances with a ``scale`` (3,) of axes.

    Pairs include drones that are not simulated, except pairs of these.
    """
    task, record = flight.task, flight.record
    names = (*task.team.drone_names, *task.passing.names)
    during = record.t <= np.fmax(task.duration, flight.rested) + ROUNDING
    passing = task.passing.at(record.index[during])
    drones = np.concatenate([record.drones[during], passing], axis=1) * np.asarray(scale)
    pairs, distances = list[int](), list[float]()
    count = task.team.drones
    for row in drones:
        between = cdist(row[:count], row)
        np.fill_diagonal(between, np.inf)
        pairs.append(int(np.argmin(between)))
        distances.append(float(np.min(between)))
    first = int(np.argmin(distances))
    i, j = divmod(pairs[first], len(names))
    return Closest((names[i], names[j]), distances[first], float(record.t[first]))


def warnings(task: Task, settings: Settings) -> tuple[str, ...]:
    """Return warnings about quantities that the plan leaves open, and drones not simulated."""
    frictionless = any(not part.team.friction for part in task.teams)
    messages = [NO_FRICTION] if settings.friction is None and frictionless else []
    weightless = [part for part in task.teams if not part.team.cable_density]
    if settings.cables == CLASPS:
        spans = (
            f"{span.first / RATE:.1f} to {span.last / RATE:.1f} s"
            for part in task.teams
            for span in closed_spans(part)
        )
        messages.append(HITCHED.format(" and ".join(spans)))
    elif weightless and settings.density is None:
        each = (simulated_density(x.team, settings, largest_tension(x)) for x in weightless)
        density = max(each)
        messages.append(WEIGHTLESS.format(1e3 * density, settings.preset.name))
    controllers = sorted(name or "none" for name in named_controllers(task))
    has_loops = task.received is not None and bool(task.received.loops)
    is_open = settings.controller is None and settings.drones is None and not has_loops
    if is_open and len(controllers) > 1:
        messages.append(f"{', '.join(controllers)}: {SEVERAL}")
    if task.passing.names:
        names = dict.fromkeys(map(team_of, task.passing.names))
        messages.append(f"{', '.join(names)}: {NOT_FLOWN}")
    return tuple(messages)
