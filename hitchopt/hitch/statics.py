"""Static forces: the balance at the clasps, and what cables do to drones.

At ``p_k`` cables k-1 and k bend around each other without friction (eq. (2)
of the paper, in its general form, ``w_k`` an outside load):
``T_k q̂_k + T_k u_k + T_{k-1} r̂_{k-1} - T_{k-1} u_{k-1} + w_k = 0``. Arrays carry any leading
axes (times, for instance); the cable index is the last axis but the coordinates. Results at clasps
are in the order of ``Layout.clasps``: all n points of a closed hitch, the n - 1 inner ones of a
chain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.cable_spans import ClaspLoads
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.layout import CLOSED, Index, layout_of
from hitchopt.hitch.team import GRAVITY, Team
from hitchopt.values import Array

STEP = 1e-5
"""[s] Step of central differences of cable forces: at 1 m/s a leg of 0.1 m turns by 1e-4 in it, so
that they err by 1e-9 of themselves."""

PASSES = 3
"""Times that a force triangle is closed, since pulls grow with the height that legs rise to: the
third one leaves less than 1e-4 of the tension."""


def leg_directions(
    edge_directions: Array,
    tensions: ArrayLike,
    topology: str = CLOSED,
    loads: ClaspLoads | None = None,
    arriving: Array | None = None,
    leg_pulls: Array | None = None,
) -> tuple[Array, Array]:
    """Return the directions of the legs that hold a hitch in balance.

    The two unknown unit vectors at a vertex close a triangle with the sides ``P_q``, ``P_r``, the
    pulls of the legs, and the known ``V = T_{k-1} u_{k-1} - T_k u_k - w_k``. Without loads
    ``P_q = T_k``, ``P_r = T_{k-1}``, and of the two solutions in their plane this is the clasp; for
    equal tensions it is the paper's class ``q̂_k = u_{k-1}``, ``r̂_{k-1} = -u_k`` (its eq. (3)).

    With loads the triangle is turned about V by the roll, ``P_q q̂_k = a v̂ + h m``, ``P_r r̂_{k-1} =
    (|V| - a) v̂ - h m`` with ``a = (|V|² + P_q² - P_r²) / (2 |V|)``, ``h = √(P_q² - a²)``; m has the
    angle ψ from ``m_0``, along ``u_{k-1} + u_k``, to ``m_1 = m_0 × v̂``. A leg's pull grows with its
    height by half of its weight, ``P = T + ½ ρ g d q̂_z``: so its tension is ``T_k`` at the clasp
    and ``T_k + ρ g (z - z_k)`` at the drone.

    Parameters
    ----------
    edge_directions: (…, n, 2 or 3) unit vectors ``u_k``.
    tensions: (…, n) or scalar [N], positive.
    loads: of the clasps, or None where they carry nothing and legs are not rolled.
    arriving: (…, n, 2 or 3) unit vectors of edges at ``p_{k+1}``, where they bend on their way from
        ``p_k``; None where they are straight.
    leg_pulls: (…, n, 2) [N], what legs pull with at their clasps where friction lets them pull
        otherwise than their edges; None where they pull alike.

    Returns
    -------
    q: (…, n, 2 or 3) unit vectors from ``p_k`` to ``q_k``; with loads they have three coordinates.
    r: (…, n, 2 or 3) unit vectors from ``p_{k+1}`` to ``r_k``.
    Where a chain's end has no leg: away from its edge, the cable's direction there.

    Raises
    ------
    InfeasibleError: a load that the tensions cannot carry.
    """
    edges = np.asarray(edge_directions, dtype=np.float64)
    pulls = np.broadcast_to(np.asarray(tensions, dtype=np.float64), edges.shape[:-1])[..., None]
    layout = layout_of(edges.shape[-2], topology)
    if leg_pulls is not None and loads is None:
        shape = (*leg_pulls.shape[:-2], len(layout.clasps))
        loads = ClaspLoads(np.zeros((*shape, 3)), np.zeros((*shape, 2)), np.zeros(shape))
    if loads is not None and edges.shape[-1] == 2:
        edges = np.concatenate([edges, np.zeros_like(edges[..., :1])], axis=-1)
    u, T = edges[..., layout.ahead, :], pulls[..., layout.ahead, :]
    onward = edges if arriving is None else arriving
    behind, T_behind = onward[..., layout.behind, :], pulls[..., layout.behind, :]
    q, r = -edges, edges.copy()
    V = T_behind * behind - T * u
    if loads is None:
        squared = np.sum(V * V, axis=-1, keepdims=True)
        q_at_clasp = u - 2.0 * np.sum(u * V, axis=-1, keepdims=True) / squared * V
        r_at_clasp = 2.0 * np.sum(behind * V, axis=-1, keepdims=True) / squared * V - behind
        equal = np.equal(T, T_behind)  # exact there, and free of the cancellation in V
        q_at_clasp = np.where(equal, behind, q_at_clasp)
        r_at_clasp = np.where(equal, -u, r_at_clasp)
    else:
        triangle = _Triangle.about(V, behind + u, loads, layout.clasps)
        r_own, q_own = T_behind, T
        if leg_pulls is not None:
            r_own, q_own = leg_pulls[..., layout.behind, 1:], leg_pulls[..., layout.ahead, :1]
        r_pull, q_pull = r_own, q_own
        for _ in range(PASSES):
            r_at_clasp, q_at_clasp = triangle.closed(r_pull, q_pull)
            r_pull = r_own + loads.halves[..., :1] * r_at_clasp[..., 2:]
            q_pull = q_own + loads.halves[..., 1:] * q_at_clasp[..., 2:]
    q[..., layout.ahead, :], r[..., layout.behind, :] = q_at_clasp, r_at_clasp
    return q, r


@dataclass(frozen=True, eq=False)
class _Triangle:
    """The known side of the force triangles at all clasps, and the plane that each lies in.

    Attributes
    ----------
    edges, load: (…, clasps, 3) [N], what edges pull with, and outside forces: their difference is
        the known side V.
    along, across: (…, clasps, 3) unit vectors: along V, and m normal to it.
    size: (…, clasps, 1) [N], of V.
    points: (clasps,), the points that they are at.
    """

    edges: Array
    load: Array
    along: Array
    across: Array
    size: Array
    points: Index

    @classmethod
    def about(cls, edges: Array, onward: Array, loads: ClaspLoads, points: Index) -> _Triangle:
        """Return the triangles of what edges pull with and the directions that they go on in."""
        V = edges - loads.forces
        size = np.linalg.norm(V, axis=-1, keepdims=True)
        along = V / size
        level = unit(onward - np.sum(onward * along, axis=-1, keepdims=True) * along)
        roll = loads.roll[..., None]
        across = np.cos(roll) * level + np.sin(roll) * np.cross(level, along)
        return cls(edges, loads.forces, along, across, size, points)

    def closed(self, behind: Array, ahead: Array) -> tuple[Array, Array]:
        """Return the directions of r- and q-legs that pull with ``behind`` and ``ahead`` [N]."""
        a = (self.size**2 + ahead**2 - behind**2) / (2.0 * self.size)
        squared = (ahead - a) * (ahead + a)
        if not np.all(squared > 0.0):
            raise self._unbalanced(behind, ahead, squared)
        aside = np.sqrt(squared) * self.across
        return ((self.size - a) * self.along - aside) / behind, (a * self.along + aside) / ahead

    def _unbalanced(self, behind: Array, ahead: Array, squared: Array) -> InfeasibleError:
        """Return the refusal of the clasp that is farthest from any balance.

        Legs pull with at least the difference of their tensions, with at most their sum.

        Parameters
        ----------
        behind, ahead: (…, clasps, 1) [N], what the legs pull with.
        squared: (…, clasps, 1) [N²], negative where the triangle does not close.
        """
        worst = np.unravel_index(int(np.argmin(squared)), squared.shape)[:-1]
        whole = float(self.size[worst][0])
        apart = float(np.abs(behind[worst] - ahead[worst])[0])
        pull = float((behind[worst] + ahead[worst])[0])
        name, value, most = "tension", apart, whole
        remedy = "make the tensions of the clasp's cables more alike, or turn them by more there"
        if whole >= pull:
            # The share of the load at which |edges - share · load| is the sum of both pulls.
            load, edges = self.load[worst], self.edges[worst]
            against, weight = float(edges @ load), float(np.linalg.norm(load))
            spare = max(pull * pull - float(edges @ edges), 0.0)
            root = math.sqrt(against * against + weight * weight * spare)
            name, value = "load", weight
            most = (against + root) / weight if weight > 0.0 else 0.0
            factor = value / most if most > 0.0 else math.inf
            lighter = "lower team.load or team.cable_density"
            remedy = f"raise team.tension {factor:.3g} times, or {lighter}"
        point = f"p{self.points[worst[-1]]}"
        return InfeasibleError([Violation(name, value, most, "max", "N", (point,), "", remedy)])


def contact_forces(
    edge_directions: Array,
    tensions: ArrayLike,
    topology: str = CLOSED,
    loads: ClaspLoads | None = None,
) -> Array:
    """Return the forces with which the two cables of each clasp press on each other.

    ``2 T_k T_{k-1} sin φ / |V|`` without loads, φ the exterior angle; positive where the clasp
    bears. With loads it is the size of ``C = F_k - w^k``, ``F_k = -(P_q q̂_k + T_k u_k)`` what cable
    k presses with and ``w^k`` half of the load, negative unless ``C·q̂_k < 0``, ``C·u_k < 0``,
    ``C·r̂_{k-1} > 0`` and ``C·u_{k-1} < 0``: then the cables would slip off each other.

    Parameters
    ----------
    edge_directions: (…, n, 2 or 3) unit vectors ``u_k``.
    tensions: (…, n) or scalar [N].
    loads: as for ``leg_directions``.

    Returns
    -------
    (…, clasps) [N]
    """
    u = np.asarray(edge_directions, dtype=np.float64)
    T = np.broadcast_to(np.asarray(tensions, dtype=np.float64), u.shape[:-1])
    layout = layout_of(u.shape[-2], topology)
    q, r = leg_directions(u, T, topology, loads)
    if loads is None:
        bend: Array = T * length(u + q)  # what a cable bent by a clasp presses with
        return bend[..., layout.ahead]
    if u.shape[-1] == 2:
        u = np.concatenate([u, np.zeros_like(u[..., :1])], axis=-1)
    q, u_ahead = q[..., layout.ahead, :], u[..., layout.ahead, :]
    r, u_behind = r[..., layout.behind, :], u[..., layout.behind, :]
    pull = T[..., layout.ahead, None] + loads.halves[..., 1:] * q[..., 2:]
    C = -(pull * q + T[..., layout.ahead, None] * u_ahead) - 0.5 * loads.forces
    signs = [dot(C, q), dot(C, u_ahead), -dot(C, r), dot(C, u_behind)]
    bears = np.max(np.stack(signs), axis=0) < 0.0
    forces: Array = np.where(bears, 1.0, -1.0) * length(C)
    return forces


def hanging_forces(team: Team, drones: Array) -> Array:
    """Return the force of hanging cables on drones that are at (…, 2n, 3) [m], in [N] likewise.

    Zero where cables weigh nothing.
    """
    if team.cable_density == 0.0:
        return np.zeros(drones.shape)
    q, r = drones[..., 0::2, :], drones[..., 1::2, :]
    pull = Catenary.between(q, r, team.cable_length).pull(q, r)
    forces: Array = GRAVITY * team.cable_density * pull.reshape(drones.shape)
    return forces


def cable_forces(team: Team, drones: Array, vertices: Array, pulls: Array, taut: Array) -> Array:
    """Return the force of cables on drones (…, 2n, 3) [N], between hanging free and taut.

    A leg pulls toward its vertex (at a chain's end the edge along itself) with its tension at the
    clasp and what that grows by with half of its height, ``P + ½ ρ g (z - z_k)``, and puts half
    of its weight on its drone; the other half, and half of every edge, is on the clasps. While a
    tension rises from 0 every weight passes from hanging cables to taut ones by the share ``taut``:
    of what a clasp carries in the end it carries that share, of its load likewise, and the same
    share of the leg's weight is on the drone. Weights and tensions then keep their ratio, so that
    legs keep their directions while cables are drawn taut and no force jumps.

    Parameters
    ----------
    drones: (…, 2n, 3) [m]
    vertices: (…, points, 3) [m]
    pulls: (…, 2n) [N], tensions of the legs at their clasps; 0 while there is no hitch.
    taut: (…, n), from 0 to 1.
    """
    if not team.has_cables:
        return np.zeros(drones.shape)
    spans = drones - vertices[..., team.layout.pulled_to, :]
    if team.cable_density == 0.0:
        return taut_forces(spans, pulls)
    share = np.repeat(taut, 2, axis=-1)
    forces = taut_forces(spans, pulls, 0.5 * GRAVITY * team.cable_density * share)
    if np.any(share < 1.0):
        forces += (1.0 - share)[..., None] * hanging_forces(team, drones)
    return forces


def taut_forces(spans: Array, pulls: Array, half: Array | float = 0.0) -> Array:
    """Return the forces (…, 3) [N] of taut cables on drones.

    Parameters
    ----------
    spans: (…, 3) [m], from where each cable pulls to, to its drone.
    pulls: (…) [N], tensions at the clasps.
    half: (…) [N/m], half of the weight of a metre of cable.
    """
    # A leg without length has no direction: no force rather than nan (certified plans have none).
    directions = unit(spans)
    if not np.any(half):
        return 0.0 - pulls[..., None] * directions  # no negative zeros
    forces: Array = 0.0 - (pulls + half * spans[..., 2])[..., None] * directions
    forces[..., 2] -= half * length(spans)
    return forces


def cable_force_rates(team: Team, values: tuple[Array, ...], rates: tuple[Array, ...]) -> Array:
    """Return the derivative by time of ``cable_forces``, (…, 2n, 3) [N/s], by central differences.

    Parameters
    ----------
    values: drones, vertices, pulls and tautness, as ``cable_forces`` takes them.
    rates: their derivatives by time.
    """
    later, earlier = (
        cable_forces(team, *(v + step * r for v, r in zip(values, rates, strict=True)))
        for step in (STEP, -STEP)
    )
    change: Array = (later - earlier) / (2.0 * STEP)
    return change
