"""Static forces: the balance at the clasps, and cable forces on drones.

At ``p_k`` cables k-1 and k bend around each other without friction (eq. (2) of the paper, in its
general form with an external load ``w_k``):
``T_k q̂_k + T_k u_k + T_{k-1} r̂_{k-1} - T_{k-1} u_{k-1} + w_k = 0``. Arrays may have any leading
axes, times for instance; the cable index is the last axis before the coordinates. Results at clasps
are in the order of ``Layout.clasps``: all n points of a closed hitch, the n - 1 inner ones of a
chain.

``closed_triangle`` solves this balance as a formula over ``Series``, which serves hitches at rest
(values), paths (time derivatives) and the optimiser (casadi expressions).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.quadrotor import GRAVITY
from hitchopt.hitch.series import Series
from hitchopt.hitch.team import CLOSED, Team, layout_of
from hitchopt.values import Array


def chord_pull(tension: Any, half: Any, level: Any = 1.0, rise: Any = None) -> Any:
    """Return the pull ``P`` of a cable part along its chord [N].

    Half of the part's weight w acts at each end. On the end where its tension is T the part exerts
    ``P ê - (w/2) ẑ``, where ê points along the chord, at the angle γ above horizontal: ``P = (w/2)
    sin γ + √(T² - (w/2)² cos² γ)``. The root is zero if T is less than half of the weight's share.
    The arguments are arrays, or any type with products and a ``root``: series, enclosures.

    Parameters
    ----------
    tension: at the end [N].
    half: half of the weight per length [N/m].
    level: squared horizontal length of the chord [m²].
    rise: height of the chord's other end over this one [m]; None for edges, whose tension is the
        same at both ends, so that only the root remains.
    """
    squared = tension * tension - half * half * level
    is_array = isinstance(squared, (float, np.ndarray))
    pull = np.sqrt(np.maximum(squared, 0.0)) if is_array else squared.root
    return pull if rise is None else half * rise + pull


@dataclass(frozen=True, eq=False)
class ClaspLoads:
    """Loads of the clasps of a hitch, and roll of their legs out of the plane."""

    forces: Array  # (…, clasps, 3) [N], external forces ``w_k``; a weight points down
    halves: Array  # (…, clasps, 2) [N], half of the weights of the legs of ``r_{k-1}`` and ``q_k``
    roll: Array  # (…, clasps) [rad], ``ψ_k``; positive raises ``q_k`` and lowers ``r_{k-1}``
    # (…, clasps, 2) [N], half of the weights of edges k-1 and k, which reduce their pull along the
    # chord below the tension
    edges: Array


def sag_factors(team: Team, tensions: ArrayLike) -> Array:
    """Return ``(ρ g / T)² / 24`` of every cable (…, n) [1/m²]: excess length over chord cubed."""
    ratio = GRAVITY * team.cable_density / np.asarray(tensions, dtype=np.float64)
    factors: Array = ratio * ratio / 24.0
    return factors


def cable_of(chords: Array, factors: Array) -> Array:
    """Return the cable length (…) [m] of spans with chords (…, 3 or 2) [m]; level if planar."""
    level = chords[..., 0] ** 2 + chords[..., 1] ** 2
    return length(chords) * (1.0 + factors * level)


def shortening(x: Any) -> Any:
    """Return the chord of a span over its cable length, for ``x = c a² cos²α``, array or Series.

    It solves ``s (1 + c s² cos²α) = a`` by a power series of x, which is below 1e-2 in practice.
    """
    return 1.0 - x * (1.0 - x * (3.0 - x * (12.0 - 55.0 * x)))


def leg_vectors(cables: Array, directions: Array, factors: Array) -> Array:
    """Return the chords (…, 2 or 3) [m] of legs with cable lengths (…) [m] along unit vectors."""
    level = directions[..., 0] ** 2 + directions[..., 1] ** 2
    chords: Array = (cables * shortening(factors * cables**2 * level))[..., None] * directions
    return chords


def cable_slack_of(team: Team, edges: Array, tensions: ArrayLike | None = None) -> Array:
    """Return the cable length left for legs (…, n) [m], given the edge vectors (…, n, 2 or 3) [m].

    Tensions are (…, n) [N]; None for those of the team.
    """
    factors = sag_factors(team, team.tension if tensions is None else tensions)
    slack: Array = team.cable_length - cable_of(edges, factors)
    return slack


def clasp_loads(
    team: Team, q_legs: Array, slack: Array, roll: ArrayLike | None = None
) -> ClaspLoads | None:
    """Return the clasp loads of a hitch at full tension; None without loads and roll.

    A clasp carries half of its legs and of its edges, ``W_k = ½ ρ g (d_k + l_k + e_{k-1} +
    l_{k-1}) + g · load``, in cable lengths: ``d_k + l_k`` is ``L_k - e_k``.

    Parameters
    ----------
    q_legs, slack: (…, n) [m], cable lengths.
    roll: (…, clasps) [rad], or None for none.
    """
    if not team.loaded and (roll is None or not np.any(roll)):
        return None
    layout = team.layout
    half = 0.5 * GRAVITY * team.cable_density
    r_legs = np.where(layout.has_leg[:, 1], slack - q_legs, 0.0)
    q = half * (team.cable_length - r_legs)[..., layout.ahead]
    r = half * (team.cable_length - q_legs)[..., layout.behind]
    forces = np.zeros((*q.shape, 3))
    forces[..., 2] = -(q + r + GRAVITY * team.load)
    halves = half * np.stack([r_legs[..., layout.behind], q_legs[..., layout.ahead]], axis=-1)
    along = half * (team.cable_length - slack)
    edges = np.stack([along[..., layout.behind], along[..., layout.ahead]], axis=-1)
    angles = np.asarray(0.0 if roll is None else roll, dtype=np.float64)
    return ClaspLoads(forces, halves, np.broadcast_to(angles, q.shape), edges)


Sides = tuple[Series, Series]  # of both legs at a clasp, r_{k-1} and q_k


def closed_triangle(
    V: Series,
    onward: Series,
    roll: Series | None,
    tensions: Sides,
    halves: Sides | None,
    check: Callable[[Any, Any, Any], None] | None = None,
) -> Sides:
    r"""Return the directions of the legs r_{k-1} and q_k that hold a clasp in balance.

    ``P_q q̂_k = a v̂ + h m`` and ``P_r r̂_{k-1} = (|V| - a) v̂ - h m`` close a triangle with the given
    side V, where ``a = (|V|² + P_q² - P_r²) / (2 |V|)`` and ``h = √(P_q² - a²)``. Without load and
    roll the clasp is planar, and for equal tensions it is in the paper's class (its eq. (3)).

    The pull of a leg with weight depends on its rise (``chord_pull``): minus half of its weight,
    downward, it is the tension at the clasp, of known magnitude. In the plane of both legs the
    triangle then closes with the tensions' parts in the plane as sides, and with V minus the parts
    of both weights.

    Parameters
    ----------
    V: ``P_{k-1} u_{k-1} - P_k u_k - w_k``, the pull of the edges minus the load [N].
    onward: a vector on q_k's side of V without roll, in the plane of both legs.
    roll: angle ψ of m from that side toward ``m_1 = m_0 × v̂`` [rad]; None for none.
    tensions: of both legs at the clasp [N].
    halves: half of the weights of both legs [N]; None for weightless legs.
    check: called with the values of the given side and of the lengths of both others; raises if
        there is no triangle. Without it directions are nan there.
    """
    size = V.dot(V).root
    along = V / size
    across = (onward - onward.dot(along) * along).direction
    if roll is not None:
        cosine, sine = roll.cosine_and_sine
        across = cosine * across + sine * across.cross(along)
    behind, ahead = tensions
    if halves is not None:
        normal = along.cross(across)
        rise = normal.row(2)
        weights = [half.upward - half * rise * normal for half in halves]
        behind, ahead = (
            (tension * tension - half * half * rise * rise).root
            for tension, half in zip(tensions, halves, strict=True)
        )
        V = V - weights[0] - weights[1]
        size = V.dot(V).root
        along = V / size
        across = normal.cross(along)
    if check is not None:
        check(V.value, behind.value, ahead.value)
    a = 0.5 * (size + (ahead - behind) * (ahead + behind) / size)
    h = ((ahead - a) * (ahead + a)).root
    r, q = (size - a) * along - h * across, a * along + h * across
    if halves is None:
        return r / behind, q / ahead
    return (r + weights[0]).direction, (q + weights[1]).direction


def leg_directions(
    edge_directions: Array,
    tensions: ArrayLike,
    topology: str = CLOSED,
    loads: ClaspLoads | None = None,
    arriving: Array | None = None,
    leg_pulls: Array | None = None,
) -> tuple[Array, Array]:
    """Return the directions of the legs that hold a hitch in balance (``closed_triangle``).

    Parameters
    ----------
    edge_directions: (…, n, 2 or 3) unit vectors ``u_k``.
    tensions: (…, n) or scalar [N], positive.
    loads: of the clasps, or None without loads and roll.
    arriving: (…, n, 2 or 3), directions of bent edges at ``p_{k+1}``; None if edges are straight.
    leg_pulls: (…, n, 2) [N], tensions of legs that differ from those of their edges by friction;
        None for equal ones.

    Returns
    -------
    q, r: (…, n, 2 or 3) unit vectors from ``p_k`` to ``q_k`` and from ``p_{k+1}`` to ``r_k``, of
        three coordinates with loads. At a chain's ends, which have no leg, outward along the edge.

    Raises
    ------
    InfeasibleError: a load that the tensions cannot carry.
    """
    edges = np.asarray(edge_directions, dtype=np.float64)
    T = np.broadcast_to(np.asarray(tensions, dtype=np.float64), edges.shape[:-1])
    layout = layout_of(edges.shape[-2], topology)
    planar = loads is None and leg_pulls is None
    if loads is not None and edges.shape[-1] == 2:
        edges = np.concatenate([edges, np.zeros_like(edges[..., :1])], axis=-1)
    before, here = layout.behind, layout.ahead
    u, v = edges[..., here, :], (edges if arriving is None else arriving)[..., before, :]
    own = [T[..., before], T[..., here]]
    sides = own if loads is None else [chord_pull(own[i], loads.edges[..., i]) for i in range(2)]
    if leg_pulls is not None:
        own = [leg_pulls[..., before, 1], leg_pulls[..., here, 0]]
    q, r = -edges, edges.copy()
    equal = planar & (own[0] == own[1])[..., None]
    if equal.all():  # exact
        r[..., before, :], q[..., here, :] = -u, v
        return q, r

    pulled = sides[0][..., None] * v - sides[1][..., None] * u

    def check(side: Array, behind: Array, ahead: Array) -> None:
        size = np.sqrt(np.sum(side**2, axis=0, keepdims=True))
        a = (size**2 + ahead**2 - behind**2) / (2.0 * size)
        squared = ((ahead - a) * (ahead + a))[0]
        if not planar and not np.all(squared > 0.0):
            worst = np.unravel_index(int(np.argmin(squared)), squared.shape)
            pulls = (float(np.nan_to_num(pull[0][worst])) for pull in (behind, ahead))
            point = f"p{layout.clasps[worst[-1]]}"
            load = np.zeros(3) if loads is None else loads.forces[worst]
            edges = np.moveaxis(side, 0, -1)[worst] + load
            raise _unbalanced(point, edges, load, *pulls)

    rolled, halves, V = None, None, pulled
    if loads is not None:
        rolled, V = Series(loads.roll[None, None]), pulled - loads.forces
        weights = loads.halves[None, None]
        halves = Series(weights[..., 0]), Series(weights[..., 1])
    with np.errstate(all="ignore"):  # V vanishes where equal tensions pull straight on
        directions = closed_triangle(
            Series.of_vectors(V),
            Series.of_vectors(u + v),
            rolled,
            (Series(own[0][None, None]), Series(own[1][None, None])),
            halves,
            check,
        )
    r[..., before, :] = np.where(equal, -u, np.moveaxis(directions[0].value, 0, -1))
    q[..., here, :] = np.where(equal, v, np.moveaxis(directions[1].value, 0, -1))
    return q, r


def _unbalanced(
    point: str, edges: Array, load: Array, behind: float, ahead: float
) -> InfeasibleError:
    """Return the error of a clasp that these edge pulls, load and leg pulls [N] cannot balance."""
    pull, total = behind + ahead, float(length(edges - load))
    if total < pull:
        remedy = "make the tensions of the clasp's cables more alike, or turn them by more there"
        name, value, limit = "tension", abs(behind - ahead), total
    else:
        # The fraction of the load at which |edges - share · load| is the sum of both pulls.
        name, value, along = "load", float(length(load)), float(edges @ load)
        root = math.sqrt(along**2 + value**2 * max(pull**2 - float(edges @ edges), 0.0))
        limit = (along + root) / value if value > 0.0 else 0.0
        factor = value / limit if limit > 0.0 else math.inf
        remedy = f"raise team.tension {factor:.3g} times, "
        remedy += "or lower team.load or team.cable_density"
    return InfeasibleError([Violation(name, value, limit, "max", "N", (point,), "", remedy)])


def contact_forces(
    edge_directions: Array,
    tensions: ArrayLike,
    topology: str = CLOSED,
    arriving: Array | None = None,
) -> Array:
    """Return the contact forces (…, clasps) [N] between the two cables of each clasp.

    Without loads they are ``2 T_k T_{k-1} sin φ / |V|``, where φ is the exterior angle. Parameters
    are those of ``leg_directions``.
    """
    q, _ = leg_directions(edge_directions, tensions, topology, arriving=arriving)
    bend: Array = np.asarray(tensions, dtype=np.float64) * length(edge_directions + q)
    return bend[..., layout_of(q.shape[-2], topology).ahead]


def hanging_forces(team: Team, drones: Array) -> Array:
    """Return the forces (…, 2n, 3) [N] of hanging cables on drones at (…, 2n, 3) [m].

    They are zero for massless cables.
    """
    if team.cable_density == 0.0:
        return np.zeros(drones.shape)
    q, r = drones[..., 0::2, :], drones[..., 1::2, :]
    pull = Catenary.between(q, r, team.cable_length).pull(q, r)
    forces: Array = GRAVITY * team.cable_density * pull.reshape(drones.shape)
    return forces


def cable_forces(team: Team, drones: Array, points: Array, pulls: Array, taut: Array) -> Array:
    """Return the forces (…, 2n, 3) [N] of cables on drones, from hanging (taut = 0) to taut (1).

    A leg pulls its drone toward its point, the vertex, with ``chord_pull`` (without a leg, at a
    chain's end, the edge pulls toward the next vertex) and puts half of its weight on the drone;
    the clasps carry the rest. While tensions rise from 0, the share ``taut`` of all weights,
    including loads, moves from hanging to taut cables: the ratio of weights to tensions and the
    directions of legs stay constant, and no force jumps.

    Parameters
    ----------
    drones, points: (…, 2n, 3) [m], drones and the points toward which they are pulled.
    pulls: (…, 2n) [N], tensions of the legs at their clasps; 0 while there is no hitch.
    taut: (…, n), from 0 to 1.
    """
    if not team.has_cables:
        return np.zeros(drones.shape)
    spans = drones - points
    share, along = np.repeat(taut, 2, axis=-1), pulls
    half = 0.5 * GRAVITY * team.cable_density * share
    if team.cable_density > 0.0:
        level = spans[..., 0] ** 2 + spans[..., 1] ** 2
        along = chord_pull(pulls, half, level, spans[..., 2])
    # Legs of zero length exert no force; certified plans have none.
    forces: Array = 0.0 - along[..., None] * unit(spans)  # no negative zeros
    if team.cable_density > 0.0:
        forces[..., 2] -= half * length(spans)
        if np.any(share < 1.0):
            forces += (1.0 - share)[..., None] * hanging_forces(team, drones)
    return forces


def cable_force_rates(team: Team, values: tuple[Array, ...], rates: tuple[Array, ...]) -> Array:
    """Return the time derivatives (…, 2n, 3) [N/s] of ``cable_forces`` by central differences.

    ``values`` are its arguments drones, points, pulls and taut, ``rates`` their time derivatives.
    """
    step = 1e-5  # [s]; at 1 m/s a leg of 0.1 m turns by 1e-4: the relative error is 1e-9
    later, earlier = (
        cable_forces(team, *(v + sign * r for v, r in zip(values, rates, strict=True)))
        for sign in (step, -step)
    )
    return (later - earlier) / (2.0 * step)


INTEGRAL = "Integral action overrides the planned tension: 1 cm of cable error multiplies it."
SLACK = "Cables will go slack: this receiver takes no cable forces."
"""Sentences on tensions that position loops do not hold."""


def undetermined_tension(*, integral: bool, feed_forward: bool) -> tuple[str, ...]:
    """Return the reasons, in words, why a plan does not determine the tensions."""
    reasons = []
    if integral:
        reasons.append(f"{INTEGRAL} Set ki = 0.")
    if not feed_forward:
        reasons.append(f"{SLACK} If its stiffness is known, setpoints hold the tension.")
    return tuple(reasons)
