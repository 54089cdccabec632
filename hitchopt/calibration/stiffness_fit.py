"""Stiffness of the drones' position loops, from where they are on average.

On average a drone stands at ``x = x_set + (F + cable force)/k``, F what its controller feeds
forward, also while it follows set points slowly, since its controller knows their velocity.
What cables pull with follows from the balance at the clasps, whose scale is the cables' known
weight. Unknowns are the compliance 1/k of each kind of drone, a steady level wind, and the tension
of every leg and edge; a robust regression weighs displacements and forces by their own scatter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import block_array, coo_array, csr_array
from scipy.sparse.linalg import splu

from hitchopt.calibration.estimates import Estimate, scale_of
from hitchopt.calibration.force_balance import ForceBalance
from hitchopt.hitch import Team
from hitchopt.values import Array

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
