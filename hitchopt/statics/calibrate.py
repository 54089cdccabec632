"""Calibration: a team's cable lengths, stiffness and friction from a recorded flight.

On average a drone stands at ``x = x_set + (F + cable force)/k``, F what its controller feeds
forward, also while it follows set points slowly, since its controller knows their velocity.
What cables pull with follows from the balance at the clasps, whose scale is the cables' known
weight. Unknowns are the compliance 1/k of each kind of drone, a steady level wind, and the tension
of every leg and edge; a robust regression weighs displacements and forces by their own scatter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import block_array, coo_array, csr_array
from scipy.sparse.linalg import splu

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch import Team
from hitchopt.hitch.cable_parts import CableParts
from hitchopt.simulation.flight import Flight
from hitchopt.simulation.task import Task, read_task
from hitchopt.statics.friction import (
    Estimate,
    ForceBalance,
    fit_friction,
    part_pulls,
    robust_mean,
    scale_of,
    sliding_clasps,
)
from hitchopt.statics.recordings import (
    Comparison,
    Recording,
    Windows,
    compare,
    read_recording,
    windows_of,
)
from hitchopt.values import Array, not_negative, path

Index = NDArray[np.intp]

OFFSET_SCALE, FORCE_SHARE = 2e-3, 0.02
"""First guess of the scatter of displacements [m], and of forces over the tension."""

LEAST_OFFSET, LEAST_SHARE = 5e-4, 3e-3
"""Least scatter that is assumed."""

GUESS = 5.0
"""First guess of a stiffness that the team does not state [N/m]."""

MODEL_ERROR = 0.03
"""Relative standard error of a stiffness by what the balance leaves out, such as the ropes'
thickness: estimates from calm simulated flights deviate by up to 3 %."""

LARGEST_ERROR = 0.25
"""Largest relative standard error of a stiffness that counts as determined."""

SOFTEST, STIFFEST = 0.01, 1e4
"""Range in which a stiffness is searched [N/m]."""

WIND_SCALE = 0.2
"""Standard deviation of a steady wind's force that is expected beforehand [N]."""


@dataclass(frozen=True, eq=False)
class StiffnessFit:
    """What displaced drones say.

    Attributes
    ----------
    kinds: kind of each drone (2n,).
    compliance: (kinds,) [m/N], fitted.
    wind: (2,) [N], steady level force on every drone.
    tensions: (windows, unknowns) [N], of edges and legs.
    stiffness: (kinds,) estimates [N/m].
    """

    kinds: Index
    compliance: Array
    wind: Array
    tensions: Array
    stiffness: tuple[Estimate, ...]


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Weighted residuals of drones and clasps, and their derivatives.

    The unknowns are log(1/k) per kind, the wind, and all tensions.
    """

    balance: ForceBalance
    kinds: Index
    feed_forward: NDArray[np.bool_]
    offset_scale: float
    force_scale: float

    @property
    def count(self) -> int:
        """Number of kinds of drones."""
        return int(np.max(self.kinds)) + 1

    def _split(self, x: Array) -> tuple[Array, Array, Array]:
        g = self.count
        return np.exp(x[:g])[self.kinds], x[g : g + 2], x[g + 2 :]

    def _net(self, x: Array) -> Array:
        """Return (windows, 2n, 3) [N]: what displaces the drones."""
        _, wind, tensions = self._split(x)
        net = self.balance.surplus(self.feed_forward)
        net += (self.balance.leg_pulls() @ tensions).reshape(net.shape)
        net[..., :2] += wind
        return net

    def values(self, x: Array) -> Array:
        """Return the residuals of drones, clasps and the expected wind."""
        compliance, wind, tensions = self._split(x)
        windows = self.balance.windows
        off = windows.drones - windows.commanded - compliance[:, None] * self._net(x)
        force = self.balance.clasps @ tensions - self.balance.weights
        return np.concatenate(
            [off.ravel() / self.offset_scale, force / self.force_scale, wind / WIND_SCALE]
        )

    def jacobian(self, x: Array) -> csr_array:
        """Return the derivatives of ``values``, sparse."""
        compliance, _, _ = self._split(x)
        net, g = self._net(x), self.count
        moved = -compliance[:, None] * net / self.offset_scale
        rows = np.arange(net.size)
        kind = np.broadcast_to(self.kinds[:, None], net.shape).ravel()
        softer = coo_array((moved.ravel(), (rows, kind)), shape=(net.size, g))
        scale = np.broadcast_to(-compliance[:, None] / self.offset_scale, net.shape)
        axis = np.indices(net.shape)[2].ravel()
        level = axis < 2
        blown = coo_array((scale.ravel()[level], (rows[level], axis[level])), shape=(net.size, 2))
        pulled = self.balance.leg_pulls().multiply(scale.ravel()[:, None])
        forces = self.balance.clasps / self.force_scale
        calm = coo_array(np.eye(2) / WIND_SCALE)
        return block_array(
            [[softer, blown, pulled], [None, None, forces], [None, calm, None]], format="csr"
        )


def fit_stiffness(
    team: Team, balance: ForceBalance, feed_forward: NDArray[np.bool_]
) -> StiffnessFit:
    """Return the stiffness that explains where drones are on average.

    Parameters
    ----------
    team: its kinds of quadrotors are estimated separately.
    balance: over spans, at least one, such that noise averages out.
    feed_forward: (2n,), whether controllers add the cable forces of the set points.
    """
    names = sorted(set(team.quadrotor), key=repr)
    kinds = np.repeat([names.index(kind) for kind in team.quadrotor], 2)
    stated = np.array([kind.stiffness or GUESS for kind in names])
    guess = balance.first_guess()
    tension = float(np.median(balance.windows.tensions))
    task = _Residuals(balance, kinds, feed_forward, OFFSET_SCALE, FORCE_SHARE * tension)
    x = np.concatenate([-np.log(stated), np.zeros(2), guess])
    for _ in range(2):
        found = _solved(task, x)
        x = found.x
        values, drones = task.values(x), balance.windows.drones.size
        offset = task.offset_scale * float(scale_of(values[:drones]))
        force = task.force_scale * float(scale_of(values[drones:-2]))
        task = replace(
            task,
            offset_scale=max(offset, LEAST_OFFSET),
            force_scale=max(force, LEAST_SHARE * tension),
        )
    found = _solved(task, x)
    g, rows = len(names), len(found.fun)
    jacobian = csr_array(task.jacobian(found.x))
    normal = (jacobian.T @ jacobian).tocsc()
    freedom = max(rows - len(found.x), 1)
    variance = max(2.0 * found.cost / freedom, 1.0)
    columns = splu(normal).solve(np.eye(len(found.x), g))
    errors = np.sqrt(variance * np.diag(columns[:g]))
    k = np.exp(-found.x[:g])
    return StiffnessFit(
        kinds,
        1.0 / k,
        found.x[g : g + 2],
        found.x[g + 2 :].reshape(len(balance.windows.t), -1),
        tuple(_stiffness(value, error) for value, error in zip(k, errors, strict=True)),
    )


def _solved(task: _Residuals, x: Array) -> OptimizeResult:
    """Return the robust solution from x on, stiffness within its range."""
    low, high = np.full(len(x), -np.inf), np.full(len(x), np.inf)
    low[: task.count], high[: task.count] = -np.log(STIFFEST), -np.log(SOFTEST)
    return least_squares(
        task.values,
        x,
        task.jacobian,
        bounds=(low, high),
        loss="soft_l1",
        x_scale="jac",
        tr_solver="lsmr",
    )


def _stiffness(value: float, relative: float) -> Estimate:
    """Return the estimate of a stiffness [N/m], or that it is not determined."""
    if not relative <= LARGEST_ERROR:
        return Estimate.unknown(
            f"its standard error would be {relative:.0%} of it: drones are displaced by "
            "too little; fly a plan that does not know the cables' weight"
        )
    return Estimate(float(value), float(np.hypot(relative, MODEL_ERROR) * value))


LEAST_SCALE = 3e-4
"""Least scatter that is assumed of a measured cable length [m]."""


@dataclass(frozen=True, eq=False)
class Calibration(OneLine):
    """Estimates from a recorded flight, and its deviations from the plan.

    Attributes
    ----------
    task: the plan.
    recording: what was measured.
    density: of the cables [kg/m], as assumed.
    lengths: of each cable [m], between its drones: legs, edge and the arcs of their sag.
    stiffness: of the position loops of each robot's drones [N/m].
    friction: coefficient at the clasps.
    comparison: deviations from the plan.
    """

    task: Task
    recording: Recording
    density: float
    lengths: tuple[Estimate, ...]
    stiffness: tuple[Estimate, ...]
    friction: Estimate
    comparison: Comparison


def calibrate(
    recording: Recording | Flight | Path | str,
    plan: Path | str | None = None,
    *,
    density: float | None = None,
) -> Calibration:
    """Estimate cable lengths, stiffness and friction from a recorded flight of a plan.

    Lengths are the robust means of measured legs and edges, arcs included. The stiffness follows
    from where drones are on average, friction from cables that slide while drones give way: see
    ``fit_stiffness`` and ``fit_friction``. What a recording does not determine is said so.

    Parameters
    ----------
    recording: a table with the columns ``t,name,x,y,z``, the directory of a simulated flight, or
        such a recording or flight itself.
    plan: directory of the plan that was flown; None: that of the flight, or the directory that the
        recording lies in.
    density: of the cables [kg/m], as weighed; None: that of the simulated flight, else the plan's.

    Raises
    ------
    FileError: a recording or a plan that cannot be read, or a recording without its hitch.
    InputError: no plan, or a negative density.
    """
    if not isinstance(recording, Recording | Flight):
        recording = path("recording", recording)
    task = _task(recording, plan)
    if isinstance(recording, Flight):
        recording = Recording.of_flight(recording)
    elif not isinstance(recording, Recording):
        recording = read_recording(Path(recording), task.team)
    given = recording.density if density is None else not_negative("density", density)
    return estimate_team(recording, task, task.team.cable_density if given is None else given)


def estimate_team(recording: Recording, task: Task, density: float) -> Calibration:
    """Return the calibration from a recording of a task, with cables of a density [kg/m].

    Raises
    ------
    InputError: drones and vertices are never seen together while the plan has a hitch.
    """
    team = task.team
    windows = windows_of(recording, task)
    if not len(windows.t):
        raise InputError(
            "recording",
            f"{len(recording.t)} samples",
            "of a flight in which drones and vertices are seen while the plan has a hitch",
            "record the vertices too, and let t count from the plan's start",
        )
    feeds = recording.feed_forward if recording.feed_forward is not None else team.feed_forward
    winds = recording.integral if recording.integral is not None else team.integral
    fit: StiffnessFit | None = None
    remark = "integral action returns drones to their set points, whatever their stiffness"
    if not np.any(winds):
        fit = fit_stiffness(team, ForceBalance.of(team, windows.spans(), density), feeds)
    stiffness = (Estimate.unknown(remark),) * team.robots
    if fit is not None:
        stiffness = tuple(fit.stiffness[kind] for kind in fit.kinds[::2])
    friction, tensions = _friction(team, recording, windows, density, fit, stiffness, feeds)
    parts = CableParts.of(team, windows.drones, windows.vertices)
    means, errors = robust_mean(parts.lengths(density, tensions), LEAST_SCALE)
    lengths = tuple(
        Estimate(float(mean), float(error)) for mean, error in zip(means, errors, strict=True)
    )
    return Calibration(
        task, recording, density, lengths, stiffness, friction, compare(recording, task)
    )


def _task(recording: Recording | Flight | Path, plan: Path | str | None) -> Task:
    """Return the plan that was flown.

    Raises
    ------
    FileError, InputError: there is none.
    """
    if plan is not None:
        return read_task(path("plan", plan))
    if isinstance(recording, Flight):
        return recording.task
    if isinstance(recording, Recording):
        raise InputError("plan", None, "the directory of a plan", "name the plan that was flown")
    return read_task(recording.absolute().parent)


def _friction(
    team: Team,
    recording: Recording,
    windows: Windows,
    density: float,
    fit: StiffnessFit | None,
    stiffness: tuple[Estimate, ...],
    feed_forward: NDArray[np.bool_],
) -> tuple[Estimate, Array]:
    """Return the friction, and the edges' tensions (windows, n) [N], planned where unknown."""
    found = np.repeat([one.value if one.known else np.nan for one in stiffness], 2)
    k = np.where(np.isnan(found), team.stiffness, found)
    if not np.all(np.isfinite(k)):
        remark = "the drones' stiffness is neither determined nor stated by the plan's team"
        return Estimate.unknown(f"tensions are unknown: {remark}"), windows.tensions
    balance = ForceBalance.of(team, windows, density)
    wind = np.zeros(2) if fit is None else fit.wind
    pulls = part_pulls(balance, 1.0 / k, wind, feed_forward)
    friction = fit_friction(sliding_clasps(team, recording, balance, pulls))
    planned = windows.tensions
    edges = np.clip(pulls[:, : team.robots], planned / 3.0, 3.0 * planned)
    return friction, edges
