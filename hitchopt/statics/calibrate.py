"""Calibration: a team's cable lengths, stiffness and friction from a recorded flight.

It is the statics of ``energy`` turned round: places are measured, and what acts there is unknown.
On average a drone stands at ``x = x_set + (F + cable force)/k``, F what its controller feeds
forward; forces on clasps balance, and the cables' known weight gives them their scale. One problem
of robust least squares has these residuals. Unknowns of every window are the tension of every cable
and the friction that each of its legs uses, of all windows compliances 1/k, a steady level wind and
the coefficient of friction. It is solved twice: in long windows, which are free of the noise of the
drones' own positions, for the stiffness, and in short ones, in which cables slide, for friction.

Friction acts against the velocity with which one cable's surface moves over the other's. With rates
v_a and v_b at which the cables a and b of a clasp slide toward their legs, and c the cosine between
these directions where they touch, the leg of a is pulled harder than its edge by

    log(T_leg / T_edge) = μ Θ_a (v_a - c v_b)/w,    w² = v_a² + v_b² - 2 c v_a v_b,

Θ_a being the angle by which it turns in space; b likewise. It is Coulomb's law: friction on a is
``-μ N (v_a t_a - v_b t_b)/w`` with the normal force ``N = T Θ`` and directions t toward the legs,
and only its part along t_a changes the tension of a. Θ and c are geometry: cables whose ends lie in
one plane turn farther than in the plane, and touch where they cross.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import block_array, eye_array, kron
from scipy.sparse.linalg import splu

from hitchopt.errors import InputError, OneLine
from hitchopt.flights.evaluation import evaluate
from hitchopt.flights.readers import read_flight
from hitchopt.flights.recordings import (
    RecordedFlight,
    Recording,
    Windows,
    planned,
    tight,
    windows_of,
)
from hitchopt.geometry.vectors import length, unit
from hitchopt.simulation.judgement import TIGHT
from hitchopt.simulation.task import Task, read_task
from hitchopt.statics.energy import HitchEnergy, bends_of
from hitchopt.statics.settle import conditions_of, energy_of
from hitchopt.storage.archive import PLAN, reading
from hitchopt.values import Array, Indices, nonnegative, path

# Windows in which stiffness, friction, and rates of sliding are estimated [s]. Tensions of 0.5 s
# follow the noise of their drones, which makes these seem up to 24 % stiffer
SPAN, WINDOW, RATE_SPAN = 6.0, 0.5, 0.2

ROUNDS = 3  # Solutions of the problem, each with the scatter that the last one left
MOST_STEPS = 200  # Of each solution

# Least scatter in long and short windows: of displacements [m], in the latter that of the positions
# that drones measure, and of forces over the tension; first guess of the scatter over it. At clasps
# the lines of thick ropes cross off their contact: balanced to 0.3 %, instead of 4 %, by
# tensions that are free, forces would tell of displacements that downwash causes, as by drones of
# twice and more their stiffness
LONG, SHORT, FIRST = (5e-4, 4e-2), (1e-2, 3e-3), 5.0

GUESS = 5.0  # First guess of a stiffness that the team does not state [N/m]

# Prior standard deviations: of a stiffness' logarithm, of a steady wind's force [N], of a
# coefficient of friction, and of known numbers
STIFFNESS_RANGE, WIND_SCALE, FRICTION_SCALE, KNOWN = 3.0, 0.2, 10.0, 1e-6

# Standard deviation of the friction that a leg uses where cables do not slide, and of the logarithm
# of a ratio where they do
STICKING, SCATTER = 0.5, 0.01

# Relative standard error of a stiffness by effects outside the model, such as the ropes'
# thickness, and of a friction coefficient by the angles below
MODEL_ERROR, GEOMETRY_ERROR = 0.03, 0.15

# Largest errors that count as determined: of a stiffness, relative, and of a friction, absolute
LARGEST_ERROR, LARGEST_FRICTION_ERROR = 0.25, 0.1

# Angles by which cables turn in the plane [rad], that in space over it, and the cosine between the
# cables where they touch, of simulated hitches at rest without friction (10 g/m at 0.5 N)
TURNS = np.radians([0.0, 30.1, 44.9, 60.0, 74.5, 89.5, 119.2])
IN_SPACE = np.array([1.52, 1.518, 1.504, 1.483, 1.438, 1.378, 1.266])
COSINES = np.array([1.0, 0.877, 0.737, 0.559, 0.393, 0.245, -0.046])

# Rate of sliding below which its direction is blurred [m/s], by noise of positions and by contacts
# that creep: in simulations friction has a third of its size at 2 mm/s
BLURRED = 1e-2

# Least rates at which cables slide over each other in a window that counts as sliding [m/s], and at
# which the plan has to slide them, the same way: noise that slides them is no sliding
SLIDING, PLANNED = 1e-2, 5e-3

SHORTEST = 0.05  # Shortest part whose direction errs by its ends' errors alone [m]

LARGEST_DISTANCE = 0.5  # Median distance of drones to the plan from which on it is another one [m]

LEAST_LENGTH_SCATTER = 3e-4  # Least scatter that is assumed of a measured cable length [m]


@dataclass(frozen=True)
class Estimate(OneLine):
    """One estimated quantity.

    Attributes
    ----------
    value: nan where the recording does not determine it.
    error: standard error; infinite where it is not determined.
    remark: why it is not determined, or empty.
    """

    value: float = math.nan
    error: float = math.inf
    remark: str = ""

    @property
    def known(self) -> bool:
        """Whether the recording determines it."""
        return not self.remark


@dataclass(frozen=True, eq=False)
class Calibration(OneLine):
    """Estimates from a recorded flight, and its deviations from the plan.

    Attributes
    ----------
    task: the plan.
    recording: the measurements.
    density: of the cables [kg/m], as assumed.
    lengths: of each cable [m], between its drones: legs, edge and the arcs of their sag.
    stiffness: of the position loops of each robot's drones, level [N/m].
    friction: coefficient at the clasps.
    vertex_errors: (samples, points) [m], distances from the plan; nan where it has no hitch, drawn
        tight, or none was seen.
    drone_errors: (samples, 2n) [m], distances from the set points.
    """

    task: Task
    recording: Recording
    density: float
    lengths: tuple[Estimate, ...]
    stiffness: tuple[Estimate, ...]
    friction: Estimate
    vertex_errors: Array
    drone_errors: Array


def calibrate(
    recording: Recording | RecordedFlight | Path | str,
    plan: Task | Path | str | None = None,
    *,
    density: float | None = None,
) -> Calibration:
    """Estimate cable lengths, stiffness and friction from a recorded flight of a plan.

    Lengths are the medians of what cables over the measured places have, arcs included. The
    stiffness follows from where drones are on average, friction from cables that slide while drones
    give way. Estimates that a recording does not determine say why.

    Parameters
    ----------
    recording: file or directory of any format that ``read_flight`` reads, such a flight, or a
        recording of the team's drones and vertices.
    plan: directory of the plan that was flown, or its task; None: the directory that the recording
        lies in.
    density: of the cables [kg/m], as weighed; None: that of the simulated flight, else the plan's.

    Raises
    ------
    FileError: a recording or a plan that cannot be read, or a recording without its hitch.
    InputError: no plan, a negative density, drones and vertices that are never seen together while
        the plan has a hitch, or drones that are far from their plan.
    """
    recording, task = _recording_and_task(recording, plan, density)
    team, windows = task.team, windows_of(recording, task, WINDOW)
    if not len(windows):
        bound = "of a flight in which drones and vertices are seen while the plan has a hitch"
        remedy = "record the vertices too, and let t count from the plan's start"
        raise InputError("recording", f"{len(recording.t)} samples", bound, remedy)
    weighed = recording.density if density is None else nonnegative("density", density)
    weight = team.cable_density if weighed is None else weighed
    feeds = team.feed_forward if recording.feed_forward is None else recording.feed_forward
    winds = np.isinf(team.integral) if recording.integral is None else recording.integral
    loops = {"stiffness": 1.0, "integral": False, "feed_forward": feeds}
    given = conditions_of(team, cable_density=weight, **loops)

    kinds = sorted(set(team.quadrotor), key=repr)
    of_drones = np.repeat([kinds.index(each) for each in team.quadrotor], 2)
    stated = np.array([kind.loop.kp[0] for kind in kinds])
    expected = np.append(-np.log(np.where(np.isfinite(stated), stated, GUESS)), np.zeros(3))
    spread = np.array([STIFFNESS_RANGE] * len(kinds) + [WIND_SCALE, WIND_SCALE, KNOWN])
    integral = "integral action returns drones to their set points, whatever their stiffness"
    estimates = [Estimate(remark=integral)] * len(kinds)
    spans = windows_of(recording, task, SPAN)
    if not len(spans):
        short = f"the plan's hitch is seen for less than {SPAN:g} s at a stretch"
        estimates = [Estimate(remark=short)] * len(kinds)
    elif not np.any(winds):
        long = _Balance.of(task, spans, given, of_drones)
        expected, errors, _, repeats = long.fitted(expected, spread, LONG)
        found, errors = np.exp(-expected[: len(kinds)]), errors * math.sqrt(repeats)
        remedy = (
            "drones are displaced by too little; fly a plan that does not know the cables' weight"
        )
        estimates = [
            _judged(k, error * k, MODEL_ERROR, LARGEST_ERROR * k, remedy)
            for k, error in zip(found.tolist(), errors.tolist(), strict=False)
        ]
    known = [one.known for one in estimates]
    expected[: len(kinds)] = np.where(known, expected[: len(kinds)], -np.log(stated))
    balance, tensions = _Balance.of(task, windows, given, of_drones), windows.tensions
    if np.all(np.isfinite(expected)):
        slid = balance.slide(task, recording, windows)
        spread[:-1], spread[-1] = KNOWN, FRICTION_SCALE
        found, errors, tensions, _ = balance.fitted(expected, spread, SHORT)
        remedy = f"cables slide through clasps by {100 * slid:.1f} cm in all; move vertices farther"
        mu, error = max(float(found[-1]), 0.0), float(errors[-1])
        friction = _judged(mu, error, GEOMETRY_ERROR, LARGEST_FRICTION_ERROR, remedy)
    else:
        why = "the drones' stiffness is neither determined nor stated by the plan's team"
        friction = Estimate(remark=f"tensions are unknown: {why}")
    tensions = np.clip(tensions, windows.tensions / 3.0, 3.0 * windows.tensions)
    arcs = balance.energy.forces(balance.x[:, balance.energy.nodes], tensions)[1]
    whole = windows.seen[:, team.layout.starts] & windows.seen[:, team.layout.ends]
    t, places = recording.t, task.setpoints.positions
    off = length(recording.vertices - planned(task, t, task.vertices))
    return Calibration(
        task,
        recording,
        weight,
        tuple(_median(arc[use]) for arc, use in zip(arcs.T, whole.T, strict=True)),
        tuple(estimates[kinds.index(kind)] for kind in team.quadrotor),
        friction,
        np.where(tight(task, t, TIGHT)[:, None], off, np.nan),
        length(recording.drones - planned(task, t, places)),
    )


def _recording_and_task(recording: Any, plan: Any, density: float | None) -> tuple[Recording, Task]:
    """Return the recording, and the plan; InputError if its times or places are others.

    Names of the team on a clock of seconds are believed; other recordings are aligned with the
    plan, and their vertices measured from markers.
    """
    if not isinstance(recording, Recording | RecordedFlight):
        recording = path("recording", recording)
        if (recording / PLAN).is_file():
            remedy = "name the file that was recorded, or DIR/simulation"
            raise InputError("recording", str(recording), "a flight, not its plan", remedy)
        plan = Path(os.path.abspath(recording)).parent if plan is None else plan
    if plan is None:
        raise InputError("plan", None, "the directory of a plan", "name the plan that was flown")
    task = plan if isinstance(plan, Task) else read_task(path("plan", plan))
    task.refuse_several("calibrate")
    if isinstance(recording, Path):
        with reading(recording, "recording"):
            recording = _measured(read_flight(recording), task, density)
    elif isinstance(recording, RecordedFlight):
        recording = _measured(recording, task, density)
    t = recording.t
    if not np.any((t >= 0.0) & (t <= task.duration)):
        times = f"times {t[0]:.6g} to {t[-1]:.6g} s"
        bound = f"of the plan's times, 0 to {task.duration:.6g} s"
        raise InputError("recording", times, bound, "count t in seconds from the plan's start")
    off = length(recording.drones - planned(task, t, task.setpoints.positions))
    far = float(np.median(off[np.isfinite(off)])) if np.any(np.isfinite(off)) else 0.0
    if far > LARGEST_DISTANCE:
        value = f"drones {far:.4g} m from the plan at the median"
        bound = f"within {LARGEST_DISTANCE:g} m of the plan that was flown"
        remedy = "give metres, z upward, times from the plan's start, and names as in the plan"
        raise InputError("recording", value, bound, remedy)
    return recording, task


def _measured(flight: RecordedFlight, task: Task, density: float | None) -> Recording:
    """Return the drones and vertices of a recorded flight in the plan's time and frame."""
    team, own = task.team, set(flight.tracks)
    named = bool(own & set(team.point_names)) or not len(flight.markers.t)
    stated: dict[str, Any] = {}
    if flight.one_clock and not flight.epoch and named and own & set(team.drone_names):
        names = {name: name for name in team.drone_names}
        stated = {"names": names, "frame": "plan", "start": 0.0}
    return evaluate(flight, task, density=density, **stated).to_recording()


def _judged(value: float, error: float, model: float, largest: float, remedy: str) -> Estimate:
    """Return an estimate with the model's relative error, or that it is not determined."""
    if error <= largest:
        return Estimate(value, float(np.hypot(error, model * value)))
    return Estimate(remark=f"its standard error would be {error:.2g}: {remedy}")


def _median(values: Array) -> Estimate:
    """Return the median of independent values and its standard error."""
    if not len(values):
        return Estimate(remark="both its vertices are never seen together; record them too")
    middle = float(np.median(values))
    scatter = max(_scatter(values - middle), LEAST_LENGTH_SCATTER)
    error = np.sqrt(0.5 * np.pi / len(values)) * scatter if len(values) > 1 else np.inf
    return Estimate(middle, float(error))


def _scatter(residuals: Array) -> float:
    """Return the standard deviation of residuals about zero, which outliers do not change."""
    return float(1.4826 * np.median(np.abs(residuals)))


@dataclass(eq=False)
class _Balance:
    """The problem of robust least squares: drones and clasps at measured places.

    Unknowns of all windows are log(1/k) of every kind of drone, the wind (2), and the coefficient
    of friction. Those of a window are the tension of every cable and the friction that both of its
    legs use (n, 3).
    """

    energy: HitchEnergy  # of the windows; its stiffness is not used
    x: Array  # (windows, nodes, 3) [m], measured
    kinds: Indices  # (2n,) of each drone
    softer: Array  # (2n, 3), level stiffness over that of each axis
    force_errors: Array  # (windows, nodes) [N], by the standard errors of the vertices
    bends: Array  # (windows, n, 2) [rad], by which cables turn at both clasps; 1 without a leg
    pulls: Array  # (windows, n, 2), log of ratios by a coefficient of 1; zero without sliding

    @classmethod
    def of(cls, task: Task, windows: Windows, given: dict[str, Any], kinds: Indices) -> _Balance:
        """Return the problem at windows, without friction."""
        team, none = task.team, np.zeros_like(windows.positions)
        lengths = np.broadcast_to(team.cable_length, windows.tensions.shape)
        errors = {"cable_length": lengths, "offsets": none, "forces": none}
        energy = energy_of(team, given, vars(windows) | errors)
        x = np.concatenate([windows.drones, energy.start[:, team.drones :]], axis=1)
        chords, sizes, _ = energy.spans(x[:, energy.nodes])
        bends = np.where(energy.exist[:, ::2], bends_of(unit(chords)), 1.0)
        # Across a part, a force errs by the part's direction, hence by both of its ends.
        squares = np.zeros(x.shape[:2])
        squares[:, team.drones :] = windows.errors[:, team.layout.clasps] ** 2
        ends = squares[:, energy.nodes[:, :-1]] + squares[:, energy.nodes[:, 1:]]
        turned = windows.tensions[..., None] ** 2 * ends / np.maximum(sizes, SHORTEST) ** 2
        turned = np.where(energy.exist, turned, 0.0)
        forces = np.zeros(x.shape[:2])
        for part in (slice(None, -1), slice(1, None)):
            np.add.at(forces.T, energy.nodes[:, part], np.moveaxis(turned, 0, 2))
        level, rigid = team.stiffness[:, :1], np.isinf(team.stiffness)
        softer = np.where(rigid, 1.0, level / np.where(rigid, 1.0, team.stiffness))
        return cls(energy, x, kinds, softer, np.sqrt(forces), bends, 0.0 * bends)

    def residuals(self, common: Any, own: Any, scales: Array) -> Any:
        """Return the residuals (windows, …) of drones, clasps and frictions over their scatter.

        Scatter (windows, nodes) is of drones in [m], of clasps in [N].
        """
        energy, many, used = self.energy, self.energy.drones, own[..., 1:]
        at_ends = energy.forces(self.x[:, energy.nodes], own[..., 0], used)[0]
        pulls = energy.pulls(at_ends)
        pulls[:, :many, :2] -= common[-3:-1]
        drones = np.exp(common[self.kinds])[:, None] * self.softer * pulls[:, :many]
        drones = (drones + (self.x - energy.start)[:, :many]) / scales[:, :many, None]
        ratios = used * self.bends - common[-1] * self.pulls
        ratios = ratios / np.where(self.pulls != 0.0, SCATTER, STICKING * self.bends)
        parts = drones, pulls[:, many:] / scales[:, many:, None], ratios
        return np.concatenate([part.reshape(len(self.x), -1) for part in parts], axis=1)

    def fitted(
        self, expected: Array, spread: Array, least: tuple[float, float]
    ) -> tuple[Array, Array, Array, float]:
        """Return the unknowns of all windows, their standard errors, and tensions (windows, n).

        Of the former some value is ``expected`` beforehand, within a standard deviation. Errors are
        those of independent windows; forces that last, such as downwash, repeat in each: the number
        of windows that say the same comes last, and multiplies variances.
        """
        planned, many, g = self.energy.reference, self.energy.drones, len(expected)
        count, size = len(planned), 3 * planned.shape[1]
        lower = np.array([1.0, np.median(planned)]) * least
        scales, errors = FIRST * lower, self.force_errors.copy()
        errors[:, :many] *= np.exp(expected[self.kinds])
        of_nodes = (np.arange(self.x.shape[1]) >= many).astype(np.intp)
        unknown = np.append(expected, np.pad(planned[..., None], ((0, 0), (0, 0), (0, 2))))

        def values(unknown: Any) -> Any:
            own = unknown[g:].reshape(*planned.shape, 3)
            residuals = self.residuals(unknown[:g], own, np.hypot(scales[of_nodes], errors))
            return np.append(residuals, (unknown[:g] - expected) / spread)

        # Windows depend on the first unknowns and on their own.
        each = (len(values(unknown)) - g) // count
        own: Any = kron(eye_array(count), np.ones((each, size)))
        parts: Any = [[np.ones((count * each, g)), own], [eye_array(g), None]]
        options: dict[str, Any] = {"loss": "soft_l1", "x_scale": "jac", "tr_solver": "lsmr"}
        options["max_nfev"] = MOST_STEPS
        for _ in range(ROUNDS):  # the scatter that is left weighs the next one
            solution = least_squares(
                values, unknown, "cs", jac_sparsity=block_array(parts), **options
            )
            unknown, left = solution.x, solution.fun[:-g].reshape(count, -1)
            split = np.split(left, [3 * many, 3 * self.x.shape[1]], axis=1)[:2]
            scales = np.maximum(scales * [_scatter(part) for part in split], lower)
        J: Any = solution.jac
        errors = np.sqrt(np.diag(splu((J.T @ J).tocsc()).solve(np.eye(len(unknown), g))))
        off = left[:, : 3 * many]
        repeats = float(np.sum(np.sum(off, axis=0) ** 2) / max(float(np.sum(off**2)), 1e-300))
        tensions = unknown[g:].reshape(*planned.shape, 3)[..., 0]
        return unknown[:g], errors, tensions, max(repeats, 1.0)

    def slide(self, task: Task, recording: Recording, windows: Windows) -> float:
        """Set ``pulls`` where the plan slides cables over each other; return how far in all [m].

        Noise of the drones slides cables back and forth: directions are those of short spans.
        """
        layout, short = task.team.layout, windows_of(recording, task, RATE_SPAN)
        cable, side = np.stack([layout.ahead, layout.behind], axis=-1), np.arange(2)
        middle, turns = 0.5 * (short.t[1:] + short.t[:-1]), self.bends[:, cable, side]
        same = np.floor(middle / WINDOW)[:, None] == np.floor(windows.t / WINDOW)
        span, window = np.nonzero(same)
        seen = (short.seen[1:] & short.seen[:-1])[span][:, layout.clasps, None]
        total = np.zeros((len(windows), len(layout.clasps), 1))
        np.add.at(total, window, seen)

        def rates_of(drones: Array, vertices: Array) -> Array:
            """Return the rates (spans, clasps, 2) [m/s] at which legs grow."""
            legs = length(drones - vertices[:, layout.anchors])
            legs = legs.reshape(len(legs), -1, 2)[:, cable, side]
            rates = np.diff(legs, axis=0) / np.diff(short.t)[:, None, None]
            return np.where(seen, rates[span], 0.0)

        def mean(values: Array) -> Array:
            sums = np.zeros_like(turns)
            np.add.at(sums, window, values)
            return np.asarray(sums / np.maximum(total, 1))

        rates = rates_of(short.drones, short.vertices)
        pulls, rate = mean(friction_pulls(turns[window], rates, BLURRED)), mean(rates)
        plan_rate, speed = (
            mean(rates_of(short.positions, short.planned)),
            _sliding(turns, rate)[1],
        )
        usable = (total[..., 0] > 1) & (speed > SLIDING) & (_sliding(turns, plan_rate)[1] > PLANNED)
        usable &= np.sum(rate * plan_rate, axis=-1) > 0.0
        self.pulls[:, cable, side] = np.where(usable[..., None], pulls, 0.0)
        return float(np.sum(speed[usable]) * WINDOW)


def friction_pulls(turns: Array, rates: Array, blurred: float = 0.0) -> Array:
    """Return logarithms of leg over edge tensions (…, 2) that a friction coefficient of 1 causes.

    A clasp's cables turn by angles in the plane (…, 2) [rad] and slide toward their legs at rates
    (…, 2) [m/s], whose direction counts little below the rate ``blurred``.
    """
    along, speed = _sliding(turns, rates)
    in_space = turns * np.interp(np.mean(turns, axis=-1, keepdims=True), TURNS, IN_SPACE)
    pulls: Array = in_space * along / np.maximum(np.hypot(speed, blurred), 1e-12)[..., None]
    return pulls


def _sliding(turns: Array, rates: Array) -> tuple[Array, Array]:
    """Return how cables slide over each other: along both (…, 2), and in all (…) [m/s]."""
    cosine = np.interp(np.mean(turns, axis=-1, keepdims=True), TURNS, COSINES)
    along = rates - cosine * rates[..., ::-1]
    return along, np.sqrt(np.maximum(np.sum(rates * along, axis=-1), 0.0))
