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
from hitchopt.geometry.vectors import in_space, length, unit
from hitchopt.hitch.catenary import Catenary, pull_terms
from hitchopt.hitch.series import Series
from hitchopt.hitch.taut import taut_chord, taut_part
from hitchopt.hitch.team import CLOSED, Layout, Team, layout_of
from hitchopt.values import Array

T = TypeVar("T")
U = TypeVar("U")


def level_pull(tension: Any, half_weight: Any) -> Any:
    """Return the level part [N] of a tension at an end of an edge, whose ends are at one height.

    Half of the edge's weight [N] acts at each end. It is zero if the tension does not bear that.
    The arguments are arrays, or any type with products and a ``root``: series, enclosures.
    """
    squared_pull = tension * tension - half_weight * half_weight
    if isinstance(squared_pull, (float, np.ndarray)):
        return np.sqrt(np.maximum(squared_pull, 0.0))
    return squared_pull.root


@dataclass(frozen=True, eq=False)
class ClaspLoads:
    """Loads of the clasps of a hitch, and roll of their legs out of the plane."""

    forces: Array  # (…, clasps, 3) [N], external forces ``w_k``; a weight points down
    roll: Array  # (…, clasps) [rad], ``ψ_k``; positive raises ``q_k`` and lowers ``r_{k-1}``
    # (…, clasps, 2) [N], half of the weights of edges k-1 and k, which reduce their level pull
    half_edge_weights: Array


def weight_ratios(team: Team, tensions: ArrayLike) -> Array:
    """Return half of the weight per length of every cable over its tension (…, n) [1/m]."""
    half_density = 0.5 * GRAVITY * team.cable_density
    ratios: Array = half_density / np.asarray(tensions, dtype=np.float64)
    return ratios


def cable_of(chords: Array, ratios: Array) -> Array:
    """Return the cable length (…) [m] of parts with chords (…, 3 or 2) [m]; level if planar.

    ``ratios`` (…) are ``weight_ratios`` for the tensions at the start of the chords.
    """
    if not np.any(ratios):
        return length(chords)
    with np.errstate(all="ignore"):  # no part hangs so steeply that its series overflows
        chord = Series.of_vectors(in_space(chords))
        cables: Array = taut_part(chord, _constant(ratios)).length.value[0]
    return cables


def leg_vectors(cables: Array, directions: Array, ratios: Array) -> Array:
    """Return the chords (…, 2 or 3) [m] of legs with cable lengths (…) [m].

    Directions are those at the clasp, unit vectors; ``ratios`` (…) are ``weight_ratios``.
    """
    if not np.any(ratios):
        return cables[..., None] * directions
    with np.errstate(all="ignore"):
        along = Series.of_vectors(directions)
        half_weights = _constant(np.broadcast_to(ratios, cables.shape))
        chord = taut_chord(along, _constant(cables), half_weights)
    return np.moveaxis(chord.value, 0, -1)


def starting_directions(chords: Array, ratios: Array) -> Array:
    """Return the directions (…, 3) in which parts with chords (…, 3) [m] leave their first ends.

    ``ratios`` (…) are ``weight_ratios`` for the tensions there.
    """
    if not np.any(ratios):
        return unit(chords)
    part = taut_part(
        Series.of_vectors(chords), _constant(np.broadcast_to(ratios, chords.shape[:-1]))
    )
    return unit(np.moveaxis(part.force().value, 0, -1))


def cable_slack_of(team: Team, edges: Array, tensions: ArrayLike | None = None) -> Array:
    """Return the cable length left for legs (…, n) [m], given the edge vectors (…, n, 2 or 3) [m].

    Tensions are (…, n) [N]; None for those of the team.
    """
    cable_tensions = team.tension if tensions is None else tensions
    if not team.layout.closed:  # a chain's first edge may slope, and has its tension at its end
        edges = np.concatenate([-edges[..., :1, :], edges[..., 1:, :]], axis=-2)
    edge_cables = cable_of(edges, weight_ratios(team, cable_tensions))
    slack: Array = team.cable_length - edge_cables
    return slack


def clasp_loads(team: Team, slack: Array, roll: ArrayLike | None = None) -> ClaspLoads | None:
    """Return the clasp loads of a hitch at full tension; None without loads and roll.

    A clasp carries half of both edges, ``½ ρ g (l_{k-1} + l_k) + g · load`` in cable lengths
    ``l_k``; the weight of its legs turns these upward on their way to the drones.

    Parameters
    ----------
    slack: (…, n) [m], cable lengths.
    roll: (…, clasps) [rad], or None.
    """
    if not team.loaded and (roll is None or not np.any(roll)):
        return None
    layout = team.layout
    half_edges = 0.5 * GRAVITY * team.cable_density * (team.cable_length - slack)
    half_edge_weights = np.stack(
        [half_edges[..., layout.behind], half_edges[..., layout.ahead]], -1
    )
    forces = np.zeros((*half_edge_weights.shape[:-1], 3))
    forces[..., 2] = -(np.sum(half_edge_weights, axis=-1) + GRAVITY * team.load)
    angles = np.asarray(0.0 if roll is None else roll, dtype=np.float64)
    return ClaspLoads(
        forces=forces,
        roll=np.broadcast_to(angles, forces.shape[:-1]),
        half_edge_weights=half_edge_weights,
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
    check: Callable[[Any, Any, Any], None] | None = None,
) -> LegPair:
    r"""Return the directions of the legs r_{k-1} and q_k, at the clasp that they hold in balance.

    ``T_q q̂_k = a v̂ + h m`` and ``T_r r̂_{k-1} = (|V| - a) v̂ - h m`` close a triangle with the given
    side V. Its height h over that side has its foot at ``a = (|V|² + T_q² - T_r²) / (2 |V|)``, and
    ``h = √(T_q² - a²)``. Without load and roll the clasp is planar, and for equal tensions it is in
    the paper's class (its eq. (3)).

    Parameters
    ----------
    V: the pull of the edges minus the load [N].
    onward: a vector on q_k's side of V without roll, in the plane of both legs.
    roll: angle ψ of m from that side toward ``m_1 = m_0 × v̂`` [rad]; None if there is none.
    tensions: of both legs at the clasp [N].
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
    if check is not None:
        check(V.value, behind.value, ahead.value)
    foot = 0.5 * (size + (ahead - behind) * (ahead + behind) / size)
    height = ((ahead - foot) * (ahead + foot)).root
    side_behind = (size - foot) * along - height * across
    side_ahead = foot * along + height * across
    return LegPair(side_behind / behind, side_ahead / ahead)


def leg_directions(
    edge_directions: Array,
    tensions: ArrayLike,
    topology: str = CLOSED,
    loads: ClaspLoads | None = None,
    arriving: Array | None = None,
    leg_pulls: Array | None = None,
) -> tuple[Array, Array]:
    """Return the directions of the legs that hold a hitch in balance (``closed_triangle``).

    Those are the directions at the clasps, from which sagging legs turn upward.

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
    if loads is not None:
        edges = in_space(edges)
    leaving_ahead = edges[..., ahead, :]
    arriving_behind = (edges if arriving is None else arriving)[..., behind, :]
    tension_behind = edge_tensions[..., behind]
    tension_ahead = edge_tensions[..., ahead]
    if loads is None:
        edge_pull_behind = tension_behind
        edge_pull_ahead = tension_ahead
    else:
        edge_pull_behind = level_pull(tension_behind, loads.half_edge_weights[..., 0])
        edge_pull_ahead = level_pull(tension_ahead, loads.half_edge_weights[..., 1])
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
    if loads is not None:
        held = held - loads.forces
        roll = _constant(loads.roll)
    with np.errstate(all="ignore"):  # V vanishes where equal tensions pull straight on
        directions = closed_triangle(
            Series.of_vectors(held),
            Series.of_vectors(leaving_ahead + arriving_behind),
            roll,
            LegPair(_constant(tension_behind), _constant(tension_ahead)),
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

    A leg (without one, at a chain's end, the edge) pulls its drone along its upper end
    (``taut_part``). While tensions rise from 0, the share ``taut`` of all weights,
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
    if team.cable_density == 0.0:
        # Legs of zero length exert no force; certified plans have none.
        return np.asarray(0.0 - pulls[..., None] * unit(chords))  # no negative zeros
    taut_share = np.repeat(taut, 2, axis=-1)
    half_weight = 0.5 * GRAVITY * team.cable_density * taut_share  # [N/m]
    ratios = np.divide(half_weight, pulls, out=np.zeros(chords.shape[:-1]), where=pulls > 0.0)
    part = taut_part(Series.of_vectors(chords), _constant(ratios))
    upper_end = np.moveaxis(part.force(second=True).value, 0, -1)
    forces: Array = 0.0 - pulls[..., None] * upper_end
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
