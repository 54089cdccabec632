"""Calibration: a team's cable lengths, stiffness and friction from a recorded flight.

This is the inverse problem of ``energy``: positions are measured, forces are unknown. The mean
position of a drone is ``x = x_set + (F + cable force)/k``, where F is its feed-forward; forces on
clasps balance, and the known weight of the cables sets the scale. A robust least-squares problem
has these residuals. Unknowns of every window are the tension of every cable and the friction used
by each of its legs; common unknowns are compliances 1/k, a steady horizontal wind and the
coefficient of friction. The problem is solved twice: in long windows, which average the noise of
positions, for the stiffness, and in short ones, in which cables slide, for the friction.

Cables that slide use the shares of friction of ``hitchopt.hitch.twists``, times their bends. So the
coefficient of friction is that of Coulomb's law along the twist of both cables.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import block_array, eye_array, kron
from scipy.sparse.linalg import splu

from hitchopt.checks.vertex_errors import RestErrors, errors_at_rests, errors_of_sizes
from hitchopt.errors import InputError, OneLine
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.energy import HitchEnergy, bends_of, energy_of
from hitchopt.hitch.rest_errors import ErrorSizes
from hitchopt.hitch.team import Errors
from hitchopt.hitch.twists import cosine_of, sliding_parts
from hitchopt.lab.flights.evaluation import evaluate
from hitchopt.lab.flights.readers import read_flight
from hitchopt.lab.flights.recordings import (
    RecordedFlight,
    Recording,
    Windows,
    plan_at,
    taut_at,
    windows_of,
)
from hitchopt.lab.simulation.exported import team_task
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.lab.statics.equilibrium import conditions_of
from hitchopt.lab.statics.rests import DronesAtRests, drones_at_rests
from hitchopt.plan import Plan
from hitchopt.storage.archive import PLAN, reading
from hitchopt.support import Feature
from hitchopt.values import Array, Indices, counted, nonnegative
from hitchopt.values import path as checked_path
from hitchopt.values.fields import suggest_keywords

# Window in which a stiffness is estimated [s]. In windows of 0.5 s tensions correlate with the
# drones' noise, and the stiffness is biased by up to 24 %
STIFFNESS_WINDOW = 6.0
FRICTION_WINDOW = 0.5  # Window in which friction is estimated [s]
RATE_WINDOW = 0.2  # Window in which sliding rates are estimated [s]

ROUNDS = 3  # Solutions of the problem, each weighted by the scatter of the previous one
MAX_EVALUATIONS = 200  # Largest number of evaluations of the residuals in each solution

# Smallest scatter in long windows, of displacements [m] and of forces over the tension. Lines of
# thick ropes cross beside their contact: with forces balanced to 0.3 % instead of 4 %, downwash
# would bias the stiffness by a factor of two
LONG_SCATTER = (5e-4, 4e-2)
# Smallest scatter in short windows, of displacements [m] and of forces over the tension
SHORT_SCATTER = (1e-2, 3e-3)
INITIAL_SCATTER = 5.0  # Initial scatter over the smallest

INITIAL_STIFFNESS = 5.0  # Initial guess of a stiffness that the team does not state [N/m]

STIFFNESS_RANGE = 3.0  # Prior standard deviation of the logarithm of a stiffness
WIND_SCALE = 0.2  # Prior standard deviation of a steady wind's force [N]
FRICTION_SCALE = 10.0  # Prior standard deviation of a coefficient of friction
FIXED = 1e-6  # Prior standard deviation of fixed values

STICKING_SCATTER = 0.5  # Standard deviation of the friction used by a leg that sticks
# Standard deviation of the logarithm of the tension ratio of a leg that slides
SLIDING_SCATTER = 0.01

# Relative standard error of a stiffness due to effects outside the model, such as the ropes'
# thickness
MODEL_ERROR = 0.03
GEOMETRY_ERROR = 0.15  # Relative standard error of a friction coefficient due to the twists' shape

MAX_STIFFNESS_ERROR = 0.25  # Largest relative error of a stiffness that is determined
MAX_FRICTION_ERROR = 0.1  # Largest error of a friction coefficient that is determined

# Sliding rate below which the direction is uncertain [m/s], due to noise of positions and creeping
# contacts: in simulations friction has a third of its full value at 2 mm/s
UNCERTAIN_RATE = 1e-2

MIN_RATE = 1e-2  # Smallest measured sliding rate of a window in which cables slide [m/s]
# Smallest planned sliding rate in the same direction [m/s], which excludes sliding by noise
MIN_PLANNED_RATE = 5e-3

MIN_PART = 0.05  # Smallest length of a part that is assumed for the error of its direction [m]
MAX_DISTANCE = 0.5  # Largest median distance of drones from the plan that was flown [m]
MIN_LENGTH_SCATTER = 3e-4  # Smallest assumed scatter of a measured cable length [m]


@dataclass(frozen=True)
class Estimate(OneLine):
    """One estimated quantity.

    Attributes
    ----------
    value: nan if the recording does not determine it.
    error: standard error; infinite if it is not determined.
    remark: reason why it is not determined, or empty.
    """

    value: float = math.nan
    error: float = math.inf
    remark: str = ""

    @property
    def known(self) -> bool:
        """Return whether the recording determines it."""
        return not self.remark


@dataclass(frozen=True, eq=False)
class Calibration(OneLine):
    """Estimates from a recorded flight, and its deviations from the plan.

    Attributes
    ----------
    task: the plan.
    recording: the measurements.
    density: of the cables [kg/m], as assumed.
    lengths: of each robot's cable [m], between its drones along the sagging parts.
    stiffness: horizontal stiffness of the position loops of each robot's drones [N/m].
    friction: coefficient at the clasps.
    at_rests: trims of drones, and position errors at the plan's rests.
    vertex_errors: (samples, points) [m], distances from the plan; nan if its hitch is not taut
        or the vertex is not visible.
    drone_errors: (samples, 2n) [m], distances from the setpoints.
    """

    task: TeamTask
    recording: Recording
    density: float
    lengths: tuple[Estimate, ...]
    stiffness: tuple[Estimate, ...]
    friction: Estimate
    at_rests: DronesAtRests
    vertex_errors: Array
    drone_errors: Array

    @property
    def text(self) -> str:
        """The block ``team:`` in YAML, with standard errors as comments.

        Undetermined values are the plan's.
        """
        team = self.task.team.of_problem
        missing = "of the plan: not determined"
        estimated = zip(self.lengths, team.cable_length.tolist(), strict=True)
        lengths = [round(one.value, 4) if one.known else planned for one, planned in estimated]
        errors = ", ".join(f"{one.error:.1g}" if one.known else missing for one in self.lengths)
        names = [each.name for each in fields(Team) if each.name not in ("quadrotor", "assignment")]
        values = {name: _yaml(getattr(team, name)) for name in names}
        values["cable_length"] = f"{_yaml(lengths)}  # ± [m]: {errors}"
        values["errors"] = f"{_yaml(self.errors)}  # largest at rest; friction: of the plan"
        values["cable_density"] = f"{_yaml(self.density)}  # as assumed"
        values["cable_friction"] += f"  # {missing}"
        if self.friction.known:
            values["cable_friction"] = f"{self.friction.value:.3f}  # ± {self.friction.error:.1g}"
        lines = ["team:", *(f"  {name}: {text}" for name, text in values.items()), "  quadrotor:"]
        per_kind = team.drones // len(team.quadrotor)
        trims = self.at_rests.trims
        if per_kind > 1 and np.array_equal(trims[::2], trims[1::2]):
            trims = trims[::2]
        repeats = len(trims) // len(team.quadrotor)
        for k, trim in enumerate(trims.tolist()):
            kind, stiffness = team.quadrotor[k // repeats], self.stiffness[k // repeats]
            entries = {name: _yaml(value) for name, value in vars(kind).items()}
            note = missing
            if any(trim):
                entries["trim"] = _yaml([round(x, 4) for x in trim])
            if stiffness.known:
                entries["stiffness"] = f"{stiffness.value:.3g}"
                note = f"± {stiffness.error:.1g} N/m"
            flow = ", ".join(f"{name}: {text}" for name, text in entries.items())
            lines.append(f"    - {{{flow}}}  # stiffness {note}")
        return "\n".join(lines) + "\n"

    @property
    def errors(self) -> Errors:
        """Largest errors at rest, as ``team.errors`` to plan the next flight."""
        standard_errors = np.array([one.error for one in self.lengths])
        return self.at_rests.errors(self.task.team.errors or Errors(), standard_errors)

    @property
    def planned_vertex_error(self) -> float | None:
        """Bound ``vertex_error`` [m] of the plan as flown; None without a rest."""
        motion = self.task.motion
        return None if motion is None else _largest(errors_at_rests(motion))

    @property
    def vertex_error(self) -> float | None:
        """The same bound [m], with ``errors`` instead of the planned ones."""
        motion = self.task.motion
        if motion is None:
            return None
        sizes = ErrorSizes.of(
            replace(motion.team, errors=self.errors), motion.requirements.limits.tracking
        )
        return _largest(errors_of_sizes(motion, sizes))

    def save(self, path: Path | str) -> None:
        """Write ``text`` to a file."""
        checked_path("path", path).write_text(self.text, encoding="utf-8")


def _largest(rests: list[RestErrors]) -> float | None:
    """Return the largest error [m] of a vertex at any rest; None without a rest."""
    return max((float(np.max(rest.radii)) for rest in rests), default=None)


def _yaml(value: object) -> str:
    """Return a value in YAML."""

    def plain(value: Any) -> Any:
        return vars(value) if is_dataclass(value) else np.round(value, 9).tolist()

    return json.dumps(value, default=plain)


@suggest_keywords
def calibrate(
    recording: Recording | RecordedFlight | Path | str,
    plan: TeamTask | Plan | Path | str | None = None,
    *,
    density: float | None = None,
) -> Calibration:
    """Estimate cable lengths, stiffness, friction and trims from a recorded flight of a plan.

    Lengths are medians over the flight, sag included. The stiffness follows from mean displacements
    of the drones, the friction from cables that slide while drones are displaced, trims from errors
    that are the same at all rests. An estimate that is not determined states the reason.

    Parameters
    ----------
    recording: file or directory in a format of ``read_flight``, a ``RecordedFlight``, or a
        ``Recording`` of the team's drones and vertices.
    plan: the plan that was flown, or its directory; None: the directory of the recording.
    density: of the cables [kg/m]; None: that of the simulated flight, or the plan's.

    Raises
    ------
    FileError: a recording or a plan that cannot be read, or a recording without its hitch.
    InputError: no plan, a negative density, drones and vertices that are never visible together
        while the plan has a hitch, or drones that are far from their plan.
    """
    recording, task = _recording_and_task(recording, plan, density)
    team = task.team
    windows = windows_of(recording, task, FRICTION_WINDOW)
    if not len(windows.t):
        bound = "of a flight with visible drones and vertices while the plan has a hitch"
        remedy = "record the vertices too, with t from the plan's start"
        raise InputError("recording", counted(len(recording.t), "sample"), bound, remedy)
    stated_density = recording.density if density is None else nonnegative("density", density)
    rope_density = team.cable_density if stated_density is None else stated_density
    feed_forward = team.feed_forward if recording.feed_forward is None else recording.feed_forward
    winds = np.isinf(team.integral) if recording.integral is None else recording.integral
    loops = {"stiffness": 1.0, "integral": False, "feed_forward": feed_forward}
    conditions = conditions_of(team, cable_density=rope_density, **loops)
    kinds = _Kinds.of(team)
    stiffness = _Stiffness.estimated(kinds, task, recording, conditions, winds)
    balance = _Balance.of(task, windows, conditions, kinds.of_drones)
    friction, tensions = _friction(task, recording, windows, balance, stiffness.expected)
    lengths = _lengths(task, windows, balance, tensions)
    loops |= {
        "stiffness": stiffness.of_drones[:, None] / balance.relative_compliance,
        "integral": winds,
    }
    settling = conditions_of(team, cable_density=rope_density, **loops)
    t = recording.t
    setpoints = task.states.positions
    vertex_errors = length(recording.vertices - plan_at(task, t, task.states.vertices))
    return Calibration(
        task,
        recording,
        rope_density,
        tuple(lengths[edge] for edge in team.edges),
        tuple(
            stiffness.estimates[kinds.kinds.index(kind.uncalibrated)]
            for kind in team.of_problem.quadrotor
        ),
        friction,
        _at_rests(task, windows, settling, lengths),
        np.where(taut_at(task, t)[:, None], vertex_errors, np.nan),
        length(recording.drones - plan_at(task, t, setpoints)),
    )


@dataclass(frozen=True, eq=False)
class _Kinds:
    """Kinds of drones, each of which has one horizontal stiffness."""

    kinds: list[Quadrotor]
    of_drones: Indices  # (2n,), kind of each drone

    @classmethod
    def of(cls, team: Team) -> _Kinds:
        """Return the kinds of a team's drones."""
        each = [kind.uncalibrated for kind in team.kinds]
        kinds = sorted(set(each), key=repr)
        return cls(kinds, np.array([kinds.index(kind) for kind in each]))

    @property
    def stated(self) -> Array:
        """(kinds,) [N/m], nan where the team states no stiffness."""
        return np.array([kind.loop.kp[0] for kind in self.kinds])


@dataclass(frozen=True, eq=False)
class _Stiffness:
    """Estimates of the stiffness of every kind of drone, and of the steady wind."""

    kinds: _Kinds
    estimates: list[Estimate]
    expected: Array  # common unknowns of ``_Balance``; the stated stiffness if it is undetermined

    @classmethod
    def undetermined(cls, kinds: _Kinds, reason: str) -> _Stiffness:
        """Return the stated stiffness, for a reason."""
        expected = np.append(-np.log(kinds.stated), np.zeros(3))
        return cls(kinds, [Estimate(remark=reason)] * len(kinds.kinds), expected)

    @classmethod
    def estimated(
        cls, kinds: _Kinds, task: TeamTask, recording: Recording, conditions: Any, winds: Any
    ) -> _Stiffness:
        """Estimate the stiffness from mean displacements of drones in long windows.

        ``winds`` (…) are true where integral action compensates steady forces.
        """
        windows = windows_of(recording, task, STIFFNESS_WINDOW)
        if not len(windows.t):
            seconds = f"less than {STIFFNESS_WINDOW:g} s without a gap"
            return cls.undetermined(kinds, f"the plan's hitch is visible for {seconds}")
        if np.any(winds):
            action = "integral action returns drones to their setpoints"
            return cls.undetermined(kinds, f"{action}, regardless of their stiffness")
        count = len(kinds.kinds)
        initial = np.where(np.isfinite(kinds.stated), kinds.stated, INITIAL_STIFFNESS)
        prior = np.append(-np.log(initial), np.zeros(3))
        spread = np.array([STIFFNESS_RANGE] * count + [WIND_SCALE, WIND_SCALE, FIXED])
        balance = _Balance.of(task, windows, conditions, kinds.of_drones)
        expected, errors, _, variance_factor = balance.fitted(prior, spread, LONG_SCATTER)
        errors = errors * math.sqrt(variance_factor)
        remedy = "displacements of drones are too small; fly a plan without the cables' weight"
        estimates = [
            _estimate(k, error * k, MODEL_ERROR, MAX_STIFFNESS_ERROR * k, remedy)
            for k, error in zip(np.exp(-expected[:count]).tolist(), errors.tolist(), strict=False)
        ]
        determined = [one.known for one in estimates]
        expected[:count] = np.where(determined, expected[:count], -np.log(kinds.stated))
        return cls(kinds, estimates, expected)

    @property
    def of_drones(self) -> Array:
        """(2n,) [N/m], horizontal stiffness of every drone."""
        stiffness: Array = np.exp(-self.expected[: len(self.kinds.kinds)])[self.kinds.of_drones]
        return stiffness


def _lengths(
    task: TeamTask, windows: Windows, balance: _Balance, tensions: Array
) -> list[Estimate]:
    """Return lengths of cables by edge, from positions and tensions (windows, n) [N]."""
    layout = task.team.layout
    tensions = np.clip(tensions, windows.tensions / 3.0, 3.0 * windows.tensions)
    arcs = balance.energy.forces(balance.x[:, balance.energy.nodes], tensions).lengths
    visible = windows.visible[:, layout.starts] & windows.visible[:, layout.ends]
    return [_median(arcs[visible[:, edge], edge]) for edge in range(task.team.robots)]


def _friction(
    task: TeamTask, recording: Recording, windows: Windows, balance: _Balance, expected: Array
) -> tuple[Estimate, Array]:
    """Return the friction and tensions (windows, n) [N] for ``expected`` common unknowns."""
    if not np.all(np.isfinite(expected)):
        reason = "the drones' stiffness is neither determined nor stated by the plan's team"
        return Estimate(remark=f"tensions are unknown: {reason}"), windows.tensions
    distance = balance.slide(task, recording, windows)
    spread = np.full(len(expected), FIXED)
    spread[-1] = FRICTION_SCALE
    common, errors, tensions, _ = balance.fitted(expected, spread, SHORT_SCATTER)
    remedy = f"cables slide by {100 * distance:.1f} cm in total; move vertices farther"
    mu = max(float(common[-1]), 0.0)
    error = float(errors[-1])
    return _estimate(mu, error, GEOMETRY_ERROR, MAX_FRICTION_ERROR, remedy), tensions


def _at_rests(
    task: TeamTask, windows: Windows, conditions: dict[str, Any], lengths: list[Estimate]
) -> DronesAtRests:
    """Return drones at rests with measured cables, those of the plan where not determined."""
    if task.motion is None:
        return DronesAtRests.without_rests(task.team)
    cables = np.array([one.value for one in lengths])
    cables = np.where([one.known for one in lengths], cables, task.team.cable_length)
    return drones_at_rests(task.motion, windows, conditions, cables)


def _recording_and_task(
    recording: Any, plan: Any, density: float | None
) -> tuple[Recording, TeamTask]:
    """Return the recording and its plan; InputError if times or positions do not match.

    Recordings with the team's names on a clock from zero are used as they are; others are aligned
    with the plan, and their vertices measured from markers.
    """
    if not isinstance(recording, Recording | RecordedFlight):
        recording = checked_path("recording", recording)
        if (recording / PLAN).is_file():
            remedy = "name the file that was recorded, or DIR/simulation"
            raise InputError("recording", str(recording), "a flight, not its plan", remedy)
        plan = Path(os.path.abspath(recording)).parent if plan is None else plan
    if plan is None:
        raise InputError("plan", None, "the directory of a plan", "name the plan that was flown")
    task = team_task(plan, Feature.CALIBRATE)
    if isinstance(recording, Path):
        with reading(recording, "recording"):
            recording = _aligned(read_flight(recording), task, density)
    elif isinstance(recording, RecordedFlight):
        recording = _aligned(recording, task, density)
    t = recording.t
    if not np.any((t >= 0.0) & (t <= task.duration)):
        times = f"times {t[0]:.6g} to {t[-1]:.6g} s"
        bound = f"of the plan's times, 0 to {task.duration:.6g} s"
        raise InputError("recording", times, bound, "count t in seconds from the plan's start")
    off = length(recording.drones - plan_at(task, t, task.states.positions))
    distance = float(np.median(off[np.isfinite(off)])) if np.any(np.isfinite(off)) else 0.0
    if distance > MAX_DISTANCE:
        value = f"drones with a median distance of {distance:.4g} m from the plan"
        bound = f"within {MAX_DISTANCE:g} m of the plan that was flown"
        remedy = "use metres, z upward, times from the plan's start, and names as in the plan"
        raise InputError("recording", value, bound, remedy)
    return recording, task


def _aligned(flight: RecordedFlight, task: TeamTask, density: float | None) -> Recording:
    """Return the drones and vertices of a recorded flight in the plan's time and frame."""
    team = task.team
    own = set(flight.tracks)
    named = bool(own & set(team.point_names)) or not len(flight.markers.t)
    stated: dict[str, Any] = {}
    if flight.one_clock and not flight.epoch and named and own & set(team.drone_names):
        names = {name: name for name in team.drone_names}
        stated = {"names": names, "frame": "plan", "start": 0.0}
    return evaluate(flight, task, density=density, **stated).to_recording()


def _estimate(value: float, error: float, model: float, limit: float, remedy: str) -> Estimate:
    """Return an estimate with the model's relative error added; undetermined if it is too large."""
    if error <= limit:
        return Estimate(value, float(np.hypot(error, model * value)))
    return Estimate(remark=f"its standard error would be {error:.2g}: {remedy}")


def _median(values: Array) -> Estimate:
    """Return the median of independent values and its standard error."""
    if not len(values):
        return Estimate(remark="its two vertices are never visible together; record both")
    middle = float(np.median(values))
    scatter = max(_scatter(values - middle), MIN_LENGTH_SCATTER)
    error = np.sqrt(0.5 * np.pi / len(values)) * scatter if len(values) > 1 else np.inf
    return Estimate(middle, float(error))


def _scatter(residuals: Array) -> float:
    """Return a robust estimate of the standard deviation of residuals about zero."""
    return float(1.4826 * np.median(np.abs(residuals)))


@dataclass(eq=False)
class _Balance:
    """The robust least-squares problem of force balance at measured positions.

    Common unknowns are log(1/k) of every kind of drone, the wind (2) and the coefficient of
    friction. Unknowns of a window (n, 3) are the tension of every cable and the friction used by
    both of its legs.
    """

    energy: HitchEnergy  # of the windows; its stiffness is not used
    x: Array  # (windows, nodes, 3) [m], measured
    kinds: Indices  # (2n,), kind of each drone
    relative_compliance: Array  # (2n, 3), level stiffness over that of each axis
    force_errors: Array  # (windows, nodes) [N], due to the standard errors of the vertices
    bends: Array  # (windows, n, 2) [rad], of cables at both clasps; 1 without a leg
    pulls: Array  # (windows, n, 2), log tension ratios for a coefficient of 1; zero if sticking

    @classmethod
    def of(cls, task: TeamTask, windows: Windows, conditions: Any, kinds: Indices) -> _Balance:
        """Return the problem at windows, without friction."""
        team = task.team
        zero = np.zeros_like(windows.positions)
        lengths = np.broadcast_to(team.cable_length, windows.tensions.shape)
        errors = {"cable_length": lengths, "offsets": zero, "forces": zero}
        energy = energy_of(team, conditions, vars(windows) | errors)
        x = np.concatenate([windows.drones, energy.start[:, team.drones :]], axis=1)
        chords, sizes, _ = energy.spans(x[:, energy.nodes])
        bends = np.where(energy.exist[:, ::2], bends_of(unit(chords)), 1.0)
        # The error of a part's direction, hence of both ends, gives a transverse force error
        squares = np.zeros(x.shape[:2])
        squares[:, team.drones :] = windows.errors[:, team.layout.clasps] ** 2
        ends = squares[:, energy.nodes[:, :-1]] + squares[:, energy.nodes[:, 1:]]
        variances = windows.tensions[..., None] ** 2 * ends / np.maximum(sizes, MIN_PART) ** 2
        variances = np.where(energy.exist, variances, 0.0)
        forces = np.zeros(x.shape[:2])
        for part in (slice(None, -1), slice(1, None)):
            np.add.at(forces.T, energy.nodes[:, part], np.moveaxis(variances, 0, 2))
        level = team.stiffness[:, :1]
        rigid = np.isinf(team.stiffness)
        relative_compliance = np.where(rigid, 1.0, level / np.where(rigid, 1.0, team.stiffness))
        return cls(energy, x, kinds, relative_compliance, np.sqrt(forces), bends, 0.0 * bends)

    def residuals(self, common: Any, own: Any, scales: Array) -> Any:
        """Return residuals (windows, …) of drones, clasps and friction over their scatter.

        The scatter (windows, nodes) is in [m] for drones and in [N] for clasps.
        """
        energy = self.energy
        many = energy.drones
        compliance = np.exp(common[self.kinds])  # [m/N]
        wind = common[-3:-1]
        friction = common[-1]
        tensions = own[..., 0]
        used_friction = own[..., 1:]
        on_ends = energy.forces(self.x[:, energy.nodes], tensions, used_friction).on_ends
        pulls = energy.pulls(on_ends)
        pulls[:, :many, :2] -= wind
        # Pulls displace drones from their setpoints, against the loops' stiffness
        displacements = compliance[:, None] * self.relative_compliance * pulls[:, :many]
        setpoint_offsets = (self.x - energy.start)[:, :many]
        drones = (displacements + setpoint_offsets) / scales[:, :many, None]
        clasps = pulls[:, many:] / scales[:, many:, None]
        log_ratios = used_friction * self.bends - friction * self.pulls
        is_sliding = self.pulls != 0.0
        scatter = np.where(is_sliding, SLIDING_SCATTER, STICKING_SCATTER * self.bends)
        parts = drones, clasps, log_ratios / scatter
        return np.concatenate([part.reshape(len(self.x), -1) for part in parts], axis=1)

    def fitted(
        self, expected: Array, spread: Array, min_scatter: tuple[float, float]
    ) -> tuple[Array, Array, Array, float]:
        """Return common unknowns, standard errors, tensions (windows, n) and a variance factor.

        Common unknowns have priors with means ``expected`` and standard deviations ``spread``.
        Errors assume independent windows; persistent forces, such as downwash, correlate them. The
        factor is the number of windows that act as one.
        """
        planned = self.energy.reference
        many = self.energy.drones
        g = len(expected)
        count = len(planned)
        size = 3 * planned.shape[1]
        lower = np.array([1.0, np.median(planned)]) * min_scatter
        scales = INITIAL_SCATTER * lower
        errors = self.force_errors.copy()
        errors[:, :many] *= np.exp(expected[self.kinds])
        of_nodes = (np.arange(self.x.shape[1]) >= many).astype(np.intp)
        unknown = np.append(expected, np.pad(planned[..., None], ((0, 0), (0, 0), (0, 2))))

        def values(unknown: Any) -> Any:
            own = unknown[g:].reshape(*planned.shape, 3)
            residuals = self.residuals(unknown[:g], own, np.hypot(scales[of_nodes], errors))
            return np.append(residuals, (unknown[:g] - expected) / spread)

        # Residuals of a window depend on the common unknowns and on its own
        each = (len(values(unknown)) - g) // count
        own: Any = kron(eye_array(count), np.ones((each, size)))
        blocks: Any = [[np.ones((count * each, g)), own], [eye_array(g), None]]
        options: dict[str, Any] = {"loss": "soft_l1", "x_scale": "jac", "tr_solver": "lsmr"}
        options |= {"max_nfev": MAX_EVALUATIONS, "jac_sparsity": block_array(blocks)}
        for _ in range(ROUNDS):  # the scatter of the residuals weights the next round
            solution = least_squares(values, unknown, "cs", **options)
            unknown = solution.x
            residuals_by_window = solution.fun[:-g].reshape(count, -1)
            split = np.split(residuals_by_window, [3 * many, 3 * self.x.shape[1]], axis=1)[:2]
            scales = np.maximum(scales * [_scatter(part) for part in split], lower)
        J: Any = solution.jac
        errors = np.sqrt(np.diag(splu((J.T @ J).tocsc()).solve(np.eye(len(unknown), g))))
        off = residuals_by_window[:, : 3 * many]
        factor = float(np.sum(np.sum(off, axis=0) ** 2) / max(float(np.sum(off**2)), 1e-300))
        tensions = unknown[g:].reshape(*planned.shape, 3)[..., 0]
        return unknown[:g], errors, tensions, max(factor, 1.0)

    def slide(self, task: TeamTask, recording: Recording, windows: Windows) -> float:
        """Set ``pulls`` where the plan slides cables over each other; return the distance [m].

        Sliding directions are those of short windows, as noise slides cables back and forth.
        """
        layout = task.team.layout
        short = windows_of(recording, task, RATE_WINDOW)
        cable = np.stack([layout.ahead, layout.behind], axis=-1)
        side = np.arange(2)
        middle = 0.5 * (short.t[1:] + short.t[:-1])
        bends = self.bends[:, cable, side]
        one, other = (np.floor(t / FRICTION_WINDOW) for t in (middle, windows.t))
        span, window = np.nonzero(one[:, None] == other)
        visible = (short.visible[1:] & short.visible[:-1])[span][:, layout.clasps, None]
        total = np.zeros((len(windows.t), len(layout.clasps), 1))
        np.add.at(total, window, visible)

        def rates_of(drones: Array, vertices: Array) -> Array:
            """Return growth rates of legs (spans, clasps, 2) [m/s]."""
            legs = length(drones - vertices[:, layout.anchors])
            legs = legs.reshape(len(legs), -1, 2)[:, cable, side]
            rates = np.diff(legs, axis=0) / np.diff(short.t)[:, None, None]
            return np.where(visible, rates[span], 0.0)

        def mean(values: Array) -> Array:
            sums = np.zeros_like(bends)
            np.add.at(sums, window, values)
            return np.asarray(sums / np.maximum(total, 1))

        rates = rates_of(short.drones, short.vertices)
        pulls = mean(friction_pulls(bends[window], rates, UNCERTAIN_RATE))
        rate = mean(rates)
        plan_rate = mean(rates_of(short.positions, short.planned))
        speed = _sliding(bends, rate)[1]
        usable = (total[..., 0] > 1) & (speed > MIN_RATE)
        usable &= _sliding(bends, plan_rate)[1] > MIN_PLANNED_RATE
        usable &= np.sum(rate * plan_rate, axis=-1) > 0.0
        self.pulls[:, cable, side] = np.where(usable[..., None], pulls, 0.0)
        return float(np.sum(speed[usable]) * FRICTION_WINDOW)


def friction_pulls(bends: Array, rates: Array, uncertain: float = 0.0) -> Array:
    """Return logarithms of leg over edge tensions (…, 2) for a friction coefficient of 1.

    Cables of a clasp have bends (…, 2) [rad] and slide toward their legs at rates (…, 2) [m/s].
    Friction is reduced below the rate ``uncertain``.
    """
    along, speed = _sliding(bends, rates)
    pulls: Array = bends * along / np.maximum(np.hypot(speed, uncertain), 1e-12)[..., None]
    return pulls


def _sliding(bends: Array, rates: Array) -> tuple[Array, Array]:
    """Return sliding rates of cables over each other: along each (…, 2), and total (…) [m/s]."""
    return sliding_parts(np.mean(cosine_of(bends), axis=-1), rates)
