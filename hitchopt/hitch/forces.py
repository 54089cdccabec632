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
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.errors import InfeasibleError, Violation, rounded_up
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.catenary import Catenary, pull_terms
from hitchopt.hitch.series import Series
from hitchopt.hitch.team import CLOSED, Layout, Team, layout_of
from hitchopt.values import Array

T = TypeVar("T")
U = TypeVar("U")


def chord_pull(tension: Any, half_weight: Any, level: Any = 1.0, rise: Any = None) -> Any:
    """Return the pull ``P`` of a cable part along its chord [N].

    Half of the part's weight w acts at each end. On the end where its tension is T the part exerts
    ``P ê - (w/2) ẑ``, where ê points along the chord, at the angle γ above horizontal: ``P = (w/2)
    sin γ + √(T² - (w/2)² cos² γ)``. The root is zero if T is less than half of the weight's share.
    The arguments are arrays, or any type with products and a ``root``: series, enclosures.

    Parameters
    ----------
    tension: at the end [N].
    half_weight: half of the weight per length [N/m].
    level: squared horizontal length of the chord [m²].
    rise: height of the chord's other end over this one [m]; None for edges, whose tension is the
        same at both ends, so that only the root remains.
    """
    squared_pull = tension * tension - half_weight * half_weight * level
    if isinstance(squared_pull, (float, np.ndarray)):
        pull = np.sqrt(np.maximum(squared_pull, 0.0))
    else:
        pull = squared_pull.root
    if rise is None:
        return pull
    return half_weight * rise + pull


@dataclass(frozen=True, eq=False)
class ClaspLoads:
    """Loads of the clasps of a hitch, and roll of their legs out of the plane."""

    forces: Array  # (…, clasps, 3) [N], external forces ``w_k``; a weight points down
    # (…, clasps, 2) [N], half of the weights of the legs of ``r_{k-1}`` and ``q_k``
    half_leg_weights: Array
    roll: Array  # (…, clasps) [rad], ``ψ_k``; positive raises ``q_k`` and lowers ``r_{k-1}``
    half_edge_weights: Array
    """(…, clasps, 2) [N], half of the weights of edges k-1 and k, which reduce their pull along the
    chord below the tension."""


def sag_factors(team: Team, tensions: ArrayLike) -> Array:
    """Return ``(ρ g / T)² / 24`` of every cable (…, n) [1/m²]: excess length over chord cubed."""
    ratio = GRAVITY * team.cable_density / np.asarray(tensions, dtype=np.float64)
    factors: Array = ratio * ratio / 24.0
    return factors


def cable_of(chords: Array, factors: Array) -> Array:
    """Return the cable length (…) [m] of spans with chords (…, 3 or 2) [m]; level if planar."""
    level = chords[..., 0] ** 2 + chords[..., 1] ** 2
    return length(chords) * (1.0 + factors * level)


def shortening(excess: Any) -> Any:
    """Return the chord of a span over its cable length, an array or Series.

    It solves ``s (1 + c s² cos²α) = a`` for the chord s of the cable length a, by a power series of
    the relative excess ``c a² cos²α``, which is below 1e-2 in practice.
    """
    return 1.0 - excess * (1.0 - excess * (3.0 - excess * (12.0 - 55.0 * excess)))


def leg_vectors(cables: Array, directions: Array, factors: Array) -> Array:
    """Return the chords (…, 2 or 3) [m] of legs with cable lengths (…) [m] along unit vectors."""
    level = directions[..., 0] ** 2 + directions[..., 1] ** 2
    chord_lengths = cables * shortening(factors * cables**2 * level)
    chords: Array = chord_lengths[..., None] * directions
    return chords


def cable_slack_of(team: Team, edges: Array, tensions: ArrayLike | None = None) -> Array:
    """Return the cable length left for legs (…, n) [m], given the edge vectors (…, n, 2 or 3) [m].

    Tensions are (…, n) [N]; None for those of the team.
    """
    cable_tensions = team.tension if tensions is None else tensions
    edge_cables = cable_of(edges, sag_factors(team, cable_tensions))
    slack: Array = team.cable_length - edge_cables
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
    roll: (…, clasps) [rad], or None.
    """
    if not team.loaded and (roll is None or not np.any(roll)):
        return None
    layout = team.layout
    half_density = 0.5 * GRAVITY * team.cable_density  # [N/m]
    r_legs = np.where(layout.has_leg[:, 1], slack - q_legs, 0.0)
    edges = team.cable_length - slack
    # The q-leg and the edge of the cable ahead meet the edge and the r-leg of the cable behind.
    weight_ahead = half_density * (team.cable_length - r_legs)[..., layout.ahead]
    weight_behind = half_density * (team.cable_length - q_legs)[..., layout.behind]
    forces = np.zeros((*weight_ahead.shape, 3))
    forces[..., 2] = -(weight_ahead + weight_behind + GRAVITY * team.load)
    legs_of_clasps = np.stack([r_legs[..., layout.behind], q_legs[..., layout.ahead]], axis=-1)
    half_edges = half_density * edges
    edges_of_clasps = [half_edges[..., layout.behind], half_edges[..., layout.ahead]]
    angles = np.asarray(0.0 if roll is None else roll, dtype=np.float64)
    return ClaspLoads(
        forces=forces,
        half_leg_weights=half_density * legs_of_clasps,
        roll=np.broadcast_to(angles, weight_ahead.shape),
        half_edge_weights=np.stack(edges_of_clasps, axis=-1),
    )


class LegPair(NamedTuple):
    """A quantity of both legs that meet at a clasp."""

    behind: Series  # Its value for the leg of ``r_{k-1}``
    ahead: Series  # Its value for the leg of ``q_k``


def closed_triangle(
    V: Series,
    onward: Series,
    roll: Series | None,
    tensions: LegPair,
    half_weights: LegPair | None,
    check: Callable[[Any, Any, Any], None] | None = None,
) -> LegPair:
    r"""Return the directions of the legs r_{k-1} and q_k that hold a clasp in balance.

    ``P_q q̂_k = a v̂ + h m`` and ``P_r r̂_{k-1} = (|V| - a) v̂ - h m`` close a triangle with the given
    side V. Its height h over that side has its foot at ``a = (|V|² + P_q² - P_r²) / (2 |V|)``, and
    ``h = √(P_q² - a²)``. Without load and roll the clasp is planar, and for equal tensions it is in
    the paper's class (its eq. (3)).

    The pull of a leg with weight depends on its rise (``chord_pull``): minus half of its weight,
    downward, it is the tension at the clasp, of known magnitude. In the plane of both legs the
    triangle then closes with the tensions' parts in the plane as sides, and with V minus the parts
    of both weights.

    Parameters
    ----------
    V: ``P_{k-1} u_{k-1} - P_k u_k - w_k``, the pull of the edges minus the load [N].
    onward: a vector on q_k's side of V without roll, in the plane of both legs.
    roll: angle ψ of m from that side toward ``m_1 = m_0 × v̂`` [rad]; None if there is none.
    tensions: of both legs at the clasp [N].
    half_weights: half of the weights of both legs [N]; None for weightless legs.
    check: called with the values of the given side and of the lengths of both others; raises if
        there is no triangle. Without it directions are nan there.
    """
    size = V.dot(V).root
    along = V / size
    across = (onward - onward.dot(along) * along).direction
    if roll is not None:
        cosine, sine = roll.cosine_and_sine
        across = cosine * across + sine * across.cross(along)
    pull_behind, pull_ahead = tensions
    if half_weights is not None:
        normal = along.cross(across)
        rise = normal.row(2)
        weight_behind = _weight_in_plane(half_weights.behind, rise, normal)
        weight_ahead = _weight_in_plane(half_weights.ahead, rise, normal)
        pull_behind = _tension_in_plane(tensions.behind, half_weights.behind, rise)
        pull_ahead = _tension_in_plane(tensions.ahead, half_weights.ahead, rise)
        V = V - weight_behind - weight_ahead
        size = V.dot(V).root
        along = V / size
        across = normal.cross(along)
    if check is not None:
        check(V.value, pull_behind.value, pull_ahead.value)
    foot = 0.5 * (size + (pull_ahead - pull_behind) * (pull_ahead + pull_behind) / size)
    height = ((pull_ahead - foot) * (pull_ahead + foot)).root
    side_behind = (size - foot) * along - height * across
    side_ahead = foot * along + height * across
    if half_weights is None:
        return LegPair(side_behind / pull_behind, side_ahead / pull_ahead)
    return LegPair(
        behind=(side_behind + weight_behind).direction,
        ahead=(side_ahead + weight_ahead).direction,
    )


def _weight_in_plane(half_weight: Series, rise: Series, normal: Series) -> Series:
    """Return half of a leg's weight, as an upward vector, projected to the plane of both legs.

    ``rise`` is the z component of the plane's normal.
    """
    return half_weight.upward - half_weight * rise * normal


def _tension_in_plane(tension: Series, half_weight: Series, rise: Series) -> Series:
    """Return the size of a leg's tension at the clasp, projected to the plane of both legs.

    Across the plane, whose normal has the z component ``rise``, it balances half of its weight.
    """
    return (tension * tension - half_weight * half_weight * rise * rise).root


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
    BalanceError: a load that the tensions cannot carry.
    """
    edges = np.asarray(edge_directions, dtype=np.float64)
    edge_tensions = np.broadcast_to(np.asarray(tensions, dtype=np.float64), edges.shape[:-1])
    layout = layout_of(edges.shape[-2], topology)
    behind, ahead = layout.behind, layout.ahead
    if loads is not None and edges.shape[-1] == 2:
        edges = np.concatenate([edges, np.zeros_like(edges[..., :1])], axis=-1)
    leaving_ahead = edges[..., ahead, :]
    arriving_behind = (edges if arriving is None else arriving)[..., behind, :]
    tension_behind = edge_tensions[..., behind]
    tension_ahead = edge_tensions[..., ahead]
    if loads is None:
        edge_pull_behind = tension_behind
        edge_pull_ahead = tension_ahead
    else:
        edge_pull_behind = chord_pull(tension_behind, loads.half_edge_weights[..., 0])
        edge_pull_ahead = chord_pull(tension_ahead, loads.half_edge_weights[..., 1])
    if leg_pulls is not None:
        tension_behind = leg_pulls[..., behind, 1]
        tension_ahead = leg_pulls[..., ahead, 0]

    q = -edges
    r = edges.copy()
    planar = loads is None and leg_pulls is None
    equal = planar & (tension_behind == tension_ahead)[..., None]
    if equal.all():  # legs continue the edges exactly
        r[..., behind, :] = -leaving_ahead
        q[..., ahead, :] = arriving_behind
        return q, r

    held = (
        edge_pull_behind[..., None] * arriving_behind - edge_pull_ahead[..., None] * leaving_ahead
    )
    roll = None
    half_weights = None
    if loads is not None:
        held = held - loads.forces
        roll = _constant(loads.roll)
        half_weights = LegPair(
            behind=_constant(loads.half_leg_weights[..., 0]),
            ahead=_constant(loads.half_leg_weights[..., 1]),
        )
    with np.errstate(all="ignore"):  # V vanishes where equal tensions pull straight on
        directions = closed_triangle(
            Series.of_vectors(held),
            Series.of_vectors(leaving_ahead + arriving_behind),
            roll,
            LegPair(_constant(tension_behind), _constant(tension_ahead)),
            half_weights,
            None if planar else partial(_check_balance, layout, loads),
        )
    r_directions = np.moveaxis(directions.behind.value, 0, -1)
    q_directions = np.moveaxis(directions.ahead.value, 0, -1)
    r[..., behind, :] = np.where(equal, -leaving_ahead, r_directions)
    q[..., ahead, :] = np.where(equal, arriving_behind, q_directions)
    return q, r


def _constant(scalars: Array) -> Series:
    """Return scalars (…) as a constant series."""
    return Series(scalars[None, None])


class BalanceError(InfeasibleError):
    """Forces that no directions of legs, or edges around an object, balance."""


def if_balanced(query: Callable[[], T], otherwise: U) -> T | U:
    """Return what a query of forces answers, or ``otherwise`` if they have no balance."""
    try:
        return query()
    except BalanceError:
        return otherwise


def _check_balance(
    layout: Layout, loads: ClaspLoads | None, V: Array, pull_behind: Array, pull_ahead: Array
) -> None:
    """Raise BalanceError if a clasp has no balance.

    Arguments are those of the ``check`` of ``closed_triangle``: the side V (3, …, clasps) [N], and
    the pulls of both legs (1, …, clasps) [N].
    """
    size = np.sqrt(np.sum(V**2, axis=0, keepdims=True))
    foot = (size**2 + pull_ahead**2 - pull_behind**2) / (2.0 * size)
    squared_height = ((pull_ahead - foot) * (pull_ahead + foot))[0]
    if np.all(squared_height > 0.0):
        return
    worst = np.unravel_index(int(np.argmin(squared_height)), squared_height.shape)
    load = np.zeros(3) if loads is None else loads.forces[worst]
    raise _unbalanced(
        point=f"p{layout.clasps[worst[-1]]}",
        edge_pull=np.moveaxis(V, 0, -1)[worst] + load,
        load=load,
        pull_behind=float(np.nan_to_num(pull_behind[0][worst])),
        pull_ahead=float(np.nan_to_num(pull_ahead[0][worst])),
    )


BALANCE_RESERVE = 1e-6  # Reserve of tensions over those at which a clasp loses its balance


def _unbalanced(
    point: str, edge_pull: Array, load: Array, pull_behind: float, pull_ahead: float
) -> BalanceError:
    """Return the error of a clasp that these edge pulls, load and leg pulls [N] cannot balance."""
    leg_pull = pull_behind + pull_ahead
    held = float(length(edge_pull - load))
    if held < leg_pull:
        violation = Violation(
            "tension",
            abs(pull_behind - pull_ahead),
            held,
            "max",
            "N",
            (point,),
            "",
            "use more similar tensions for the clasp's cables, or a larger exterior angle",
        )
        return BalanceError([violation])
    size = float(length(load))
    limit = _bearable_load(edge_pull, load, leg_pull)
    remedy = "lower team.load or team.cable_density"
    if limit > 0.0:
        factor = rounded_up(size / limit * (1.0 + BALANCE_RESERVE), 3)
        remedy = f"multiply team.tension by {factor:.3g} or more, or {remedy}"
    return BalanceError([Violation("load", size, limit, "max", "N", (point,), "", remedy)])


def _bearable_load(edge_pull: Array, load: Array, leg_pull: float) -> float:
    """Return the size [N] of the part of a load at which ``|edge_pull - part|`` is ``leg_pull``."""
    size = float(length(load))
    if size <= 0.0:
        return 0.0
    along = float(edge_pull @ load)
    root = math.sqrt(along**2 + size**2 * max(leg_pull**2 - float(edge_pull @ edge_pull), 0.0))
    return (along + root) / size


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
    layout = layout_of(q.shape[-2], topology)
    # A cable's leg and edge pull on the other cable by T (q̂_k + u_k) together.
    forces: Array = np.asarray(tensions, dtype=np.float64) * length(edge_directions + q)
    return forces[..., layout.ahead]


def hanging_forces(team: Team, drones: Array) -> Array:
    """Return the forces (…, 2n, 3) [N] of hanging cables on drones at (…, 2n, 3) [m].

    They are zero for massless cables.
    """
    if team.cable_density == 0.0:
        return np.zeros(drones.shape)
    q = drones[..., 0::2, :]
    r = drones[..., 1::2, :]
    pull = Catenary.between(q, r, team.cable_length).pull(q, r)
    forces: Array = GRAVITY * team.cable_density * pull.reshape(drones.shape)
    return forces


def hanging_tensions(team: Team, routes: Array) -> Array:
    """Return the horizontal tensions (…, n) [N] of cables that hang along their routes.

    Where two cables hold each other at a clasp, they pull each other horizontally. Each hangs as if
    it were straight in plan view: a catenary over the horizontal length (…, n) [m] of its route
    through the clasps. Tensions are zero for massless cables.
    """
    cables = Catenary.spanning(routes, 0.0, team.cable_length)
    inward, _ = pull_terms(cables.sigma)
    tensions: Array = 0.5 * GRAVITY * team.cable_density * routes * inward
    return tensions


def cable_forces(team: Team, drones: Array, points: Array, pulls: Array, taut: Array) -> Array:
    """Return the forces (…, 2n, 3) [N] of cables on drones, from hanging (taut = 0) to taut (1).

    A leg pulls its drone toward its point, the vertex, with ``chord_pull`` (without a leg, at a
    chain's end, the edge pulls toward the next vertex) and puts half of its weight on the drone;
    the clasps carry the rest. While tensions rise from 0, the share ``taut`` of all weights,
    including loads, moves from hanging to taut cables: the ratio of weights to tensions stays
    constant, and no force jumps.

    Parameters
    ----------
    drones, points: (…, 2n, 3) [m], drones and the points toward which they are pulled.
    pulls: (…, 2n) [N], tensions of the legs at their clasps; 0 while there is no hitch.
    taut: (…, n), from 0 to 1.
    """
    if not team.has_cables:
        return np.zeros(drones.shape)
    chords = drones - points
    taut_share = np.repeat(taut, 2, axis=-1)
    half_weight = 0.5 * GRAVITY * team.cable_density * taut_share  # [N/m]
    chord_pulls = pulls
    if team.cable_density > 0.0:
        level = chords[..., 0] ** 2 + chords[..., 1] ** 2
        chord_pulls = chord_pull(pulls, half_weight, level, chords[..., 2])
    # Legs of zero length exert no force; certified plans have none.
    forces: Array = 0.0 - chord_pulls[..., None] * unit(chords)  # no negative zeros
    if team.cable_density > 0.0:
        forces[..., 2] -= half_weight * length(chords)
        if np.any(taut_share < 1.0):
            forces += (1.0 - taut_share)[..., None] * hanging_forces(team, drones)
    return forces


def cable_force_rates(team: Team, values: tuple[Array, ...], rates: tuple[Array, ...]) -> Array:
    """Return the time derivatives (…, 2n, 3) [N/s] of ``cable_forces`` by central differences.

    ``values`` are its arguments drones, points, pulls and taut, ``rates`` their time derivatives.
    """
    step = 1e-5  # [s]; at 1 m/s a leg of 0.1 m turns by 1e-4: the relative error is 1e-9
    earlier = [value - step * rate for value, rate in zip(values, rates, strict=True)]
    later = [value + step * rate for value, rate in zip(values, rates, strict=True)]
    return (cable_forces(team, *later) - cable_forces(team, *earlier)) / (2.0 * step)


INTEGRAL = "Integral action overrides the planned tension: 1 cm of cable error multiplies it."
"""Why loops with an integral do not hold planned tensions."""

SLACK = "Cables will go slack: this receiver takes no cable forces."
"""Why loops without feed-forward do not hold planned tensions."""


def undetermined_tension(*, integral: bool, feed_forward: bool) -> tuple[str, ...]:
    """Return the reasons, in words, why a plan does not determine the tensions."""
    reasons = []
    if integral:
        reasons.append(f"{INTEGRAL} Set ki = 0.")
    if not feed_forward:
        reasons.append(f"{SLACK} If its stiffness is known, setpoints hold the tension.")
    return tuple(reasons)
