"""The model in casadi: a hitch in motion as one function to differentiate and to optimise with.

``clasp_function`` states one clasp by the formula that arrays use as well (``clasp_legs``), and
``clasp_motion`` its drones in motion. ``model`` joins the clasps of a team, differentiates by time,
and adds forces and residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.errors import InputError
from hitchopt.hitch.model import Edge, cable_between, clasp_legs
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.series import JET, Series
from hitchopt.hitch.team import Team
from hitchopt.values import check_instance, flag
from hitchopt.values.fields import suggest_keywords

if TYPE_CHECKING:
    import casadi as ca

CLASP_INPUTS = {
    "points": 9,  # [m], p_{k-1}, p_k and p_{k+1}
    "q_legs": 2,  # [m], cable lengths d_{k-1} and d_k
    "tensions": 2,  # [N], of cables k-1 and k
    "roll": 1,  # [rad]
    "cable_length": 1,  # [m], of cable k-1
    "load": 1,  # [N], weight that hangs on the clasp
    "weight": 1,  # [N/m], of cables
}
"""Inputs of ``clasp_function`` and their numbers of rows."""


@lru_cache
def clasp_function(*, weighted: bool, loaded: bool, rolled: bool, equal: bool) -> ca.Function:
    """Return the function of a clasp: the drones and forces around it.

    Parameters
    ----------
    weighted: whether cables have weight.
    loaded: whether a weight hangs on the clasp.
    rolled: whether its legs roll out of the plane.
    equal: whether both tensions are equal; legs of a plain clasp then continue the edges.

    Returns
    -------
    Function of CLASP_INPUTS, of which ``weight``, ``load`` and ``roll`` only matter with their
    flags. Its outputs are ``r`` and ``q`` (3, 1) [m], the drones r_{k-1} and q_k; ``e`` [m], the
    cable length of r_{k-1}; ``turn`` and ``straight``, sine and cosine of the exterior angle at
    p_k; and ``residual`` (3, 1) [N], the sum of all forces on the clasp.
    """
    import casadi as ca

    symbols = _symbols(CLASP_INPUTS)
    point_behind, point, point_ahead = map(Series, ca.vertsplit(symbols["points"], 3))
    tension_behind, tension_ahead = map(Series, ca.vertsplit(symbols["tensions"]))
    q_leg_behind, q_leg_ahead = map(Series, ca.vertsplit(symbols["q_legs"]))
    weight = symbols["weight"] if weighted else None
    load = ca.vertcat(0.0, 0.0, -symbols["load"]) if loaded else None
    edge_behind = Edge.of(point - point_behind, tension_behind, weight, 1.0)  # that at the clasp
    edge_ahead = Edge.of(point_ahead - point, tension_ahead, weight)
    legs = clasp_legs(
        (edge_behind, edge_ahead),
        (q_leg_behind, q_leg_ahead),
        symbols["cable_length"],
        load,
        Series(symbols["roll"]) if rolled else None,
        equal=equal,
    )
    r = point + legs.chords.behind
    q = point + legs.chords.ahead
    pulls = [
        _pull_on_clasp(r - point, tension_behind, weight),
        _pull_on_clasp(point_behind - point, tension_behind, weight),
        _pull_on_clasp(q - point, tension_ahead, weight),
        _pull_on_clasp(point_ahead - point, tension_ahead, weight),
    ]
    residual = ca.SX(3, 1) if load is None else load
    for pull in pulls:
        residual = residual + pull.value
    arriving = edge_behind.along.value
    leaving = edge_ahead.along.value
    outputs = {
        "r": r.value,
        "q": q.value,
        "e": legs.r_leg.value,
        "turn": arriving[1] * leaving[0] - arriving[0] * leaving[1],
        "straight": arriving[0] * leaving[0] + arriving[1] * leaving[1],
        "residual": residual,
    }
    return ca.Function(
        "clasp", [*symbols.values()], [*outputs.values()], [*symbols], [*outputs], {"cse": True}
    )


def _pull_on_clasp(span: Series, tension: Series, weight: Any) -> Series:
    """Return the force [N] of a cable part on its clasp, from which a vector leads along it."""
    return Edge.of(span, tension, weight).first


LEG_INPUTS = {
    "span": 3,  # [m], from the vertex to the drone
    "tension": 1,  # [N], at the vertex
    "weight": 1,  # [N/m], of cables
}
"""Inputs of ``_leg_function`` and their numbers of rows."""


@lru_cache
def _leg_function(*, weighted: bool) -> ca.Function:
    """Return the function of a cable part that ends at a drone.

    Inputs are ``span`` (3, 1) [m] to the drone, ``tension`` [N] at the other end and ``weight`` of
    cables [N/m]. Outputs are ``length`` of the cable [m], ``chord`` [m] and ``force`` (3, 1) [N] on
    the drone, as of ``cable_forces``.
    """
    import casadi as ca

    symbols = _symbols(LEG_INPUTS)
    span = Series(symbols["span"])
    tension = Series(symbols["tension"])
    weight = symbols["weight"] if weighted else None
    part = Edge.of(span, tension, weight)
    outputs = {
        "length": part.cable.value,
        "chord": span.dot(span).root.value,
        "force": (-part.second).value,
    }
    return ca.Function("leg", [*symbols.values()], [*outputs.values()], [*symbols], [*outputs])


FLAT_INPUTS = ("points", "q_legs", "tensions", "roll")
"""Inputs of ``clasp_motion`` that change over time."""

MOTION_CONSTANTS = {
    "cable_lengths": 2,  # [m], of cables k-1 and k
    "load": 1,  # [N], weight that hangs on the clasp
    "weight": 1,  # [N/m], of cables
    "masses": 2,  # [kg], of the drones r_{k-1} and q_k
}
"""Inputs of ``clasp_motion`` that are constant, and their numbers of rows."""


@lru_cache
def clasp_motion(
    *, weighted: bool, loaded: bool, rolled: bool, equal: bool, last: bool = False
) -> ca.Function:
    """Return the function of a clasp in motion: its two drones up to the jerk, and their thrusts.

    Inputs are FLAT_INPUTS (rows, 4) with a column for each derivative by time, and
    MOTION_CONSTANTS. Flags are those of ``clasp_function``; ``last`` says that the cable ahead
    ends a chain, so that its q-leg takes all of its slack. Outputs are ``positions``,
    ``velocities``, ``accelerations``, ``jerks`` [m, s] and ``thrusts`` [N], (3, 2) each with
    columns r_{k-1} and q_k; ``r_leg`` [m], ``turn``, ``straight`` and ``residual`` as of
    ``clasp_function``.
    """
    import casadi as ca

    jets = {name: ca.SX.sym(name, CLASP_INPUTS[name], JET) for name in FLAT_INPUTS}
    constants = _symbols(MOTION_CONSTANTS)
    shape = {name: jet[:, 0] for name, jet in jets.items()}
    length_behind, length_ahead = ca.vertsplit(constants["cable_lengths"])
    weight = constants["weight"]
    if last:
        edge = cable_between(
            Series(shape["points"][6:] - shape["points"][3:6]),
            Series(shape["tensions"][1]),
            weight if weighted else None,
        )
        shape["q_legs"] = ca.vertcat(shape["q_legs"][0], length_ahead - edge.value)
    clasp = clasp_function(weighted=weighted, loaded=loaded, rolled=rolled, equal=equal)
    legs = clasp(**shape, cable_length=length_behind, load=constants["load"], weight=weight)
    motion = _motion(ca.horzcat(legs["r"], legs["q"]), list(jets.values()))
    point = shape["points"][3:6]
    forces = _leg_function(weighted=weighted).map(2)(
        span=motion["positions"] - ca.repmat(point, 1, 2),
        tension=shape["tensions"].T,
        weight=weight,
    )["force"]
    outputs = {
        **motion,
        "thrusts": _thrusts(constants["masses"], motion["accelerations"], forces),
        "r_leg": legs["e"],
        "turn": legs["turn"],
        "straight": legs["straight"],
        "residual": legs["residual"],
    }
    inputs = jets | constants
    return ca.Function(
        "clasp_motion", [*inputs.values()], [*outputs.values()], [*inputs], [*outputs]
    )


@lru_cache
def chain_end_motion(*, weighted: bool) -> ca.Function:
    """Return the function of the drone at an end of a chain, which is the end of its edge.

    Inputs are ``points`` (6, 4) [m], its position and the other end of the edge, and ``tension``
    (1, 4) [N], with a column for each derivative by time; ``weight`` [N/m] of cables, and ``mass``
    [kg]. Outputs are those of ``clasp_motion`` for one drone, up to its thrust.
    """
    import casadi as ca

    points = ca.SX.sym("points", 6, JET)
    tension = ca.SX.sym("tension", 1, JET)
    constants = _symbols({"weight": 1, "mass": 1})
    motion = _motion(points[:3, 0], [points])
    span = points[:3, 0] - points[3:, 0]
    leg = _leg_function(weighted=weighted)
    force = leg(span=span, tension=tension[0], weight=constants["weight"])["force"]
    thrust = _thrusts(constants["mass"], motion["accelerations"], force)
    inputs = {"points": points, "tension": tension, **constants}
    outputs = {**motion, "thrusts": thrust}
    return ca.Function(
        "chain_end_motion", [*inputs.values()], [*outputs.values()], [*inputs], [*outputs]
    )


def _motion(positions: ca.SX, jets: Sequence[ca.SX]) -> dict[str, ca.SX]:
    """Return positions (3, drones) and their derivatives by time, as far as jets have them.

    Jets (rows, count) are those of all symbols on which positions depend.
    """
    import casadi as ca

    count = jets[0].shape[1]
    state = [ca.vertcat(*(jet[:, order] for jet in jets)) for order in range(count)]
    rates = [ca.vec(positions)]
    for order in range(1, count):
        known = ca.vertcat(*state[:order])
        rates.append(ca.jtimes(rates[-1], known, ca.vertcat(*state[1 : order + 1])))
    names = ("positions", "velocities", "accelerations", "jerks")[:count]
    columns = [ca.reshape(rate, *positions.shape) for rate in rates]
    return dict(zip(names, columns, strict=True))


def _thrusts(masses: ca.SX | ca.DM, accelerations: ca.SX, cable_forces: ca.SX) -> ca.SX:
    """Return the thrusts (3, drones) [N], m (a + g ẑ) minus the forces of cables on drones."""
    import casadi as ca

    gravity = ca.repmat(ca.DM([0.0, 0.0, GRAVITY]), 1, accelerations.shape[1])
    return ca.repmat(masses.T, 3, 1) * (accelerations + gravity) - cable_forces


CostFunction = Callable[[Mapping[str, Any], Any], Any]
"""Function of the outputs of ``model`` by name, and of s, to a cost per time, all in casadi."""

SINGULAR = {"vertices": "vertex", "q_legs": "q_leg", "roll": "roll", "tensions": "tension"}
"""Prefixes of the names of derivatives, by the name of the value."""


@suggest_keywords
def model(
    team: Team,
    separation: Separation | None = None,
    *,
    roll: bool = False,
    tensions: bool = False,
    cables: bool = False,
    pairs: ArrayLike | None = None,
) -> ca.Function:
    """Return a hitch in motion as a casadi function of its flat outputs at one time.

    Values and derivatives are exact, and so is what casadi derives from them. Its ``map(J)`` takes
    J times at once, a column each. Inputs that are omitted are zero. Values are nan where tensions
    cannot carry the loads.

    Inputs are columns of values, first and second time derivatives:

    - ``vertices``, ``vertex_velocities``, ``vertex_accelerations`` (3 points, 1) [m, m/s, m/s²],
      coordinates of p_0, p_1, …;
    - ``q_legs``, ``q_leg_velocities``, ``q_leg_accelerations`` (n, 1) [m, m/s, m/s²], cable lengths
      from p_k to q_k; of a chain the first is 0, and the last one takes all that its edge leaves;
    - with ``roll`` also ``roll``, ``roll_velocities``, ``roll_accelerations`` (clasps, 1) [rad, …];
    - with ``tensions`` also ``tensions``, ``tension_velocities``, ``tension_accelerations``
      (n, 1) [N, …];
    - with ``cables`` also ``cable_lengths`` (n, 1) [m], constant.

    Outputs are columns, drones in the order q_0, r_0, q_1, …:

    - ``positions``, ``velocities``, ``accelerations`` (6n, 1) [m, m/s, m/s²];
    - ``thrusts`` (6n, 1) [N], m (a + g ẑ) minus the force of the cable on the drone;
    - ``tilt_cosines`` (2n, 1), of the angle of the thrust from vertical;
    - ``legs`` (2n, 1) [m], distances of drones from their vertices;
    - ``cable_residuals`` (n, 1) [m], lengths of legs and edge minus that of the cable;
    - ``clasp_residuals`` (3 clasps, 1) [N], sums of all forces on a clasp;
    - ``exterior_angles`` (clasps, 1) [rad], positive where the polygon is convex;
    - ``separations`` (pairs, 1), distances of drones in units of their downwash ellipsoids, 1 where
      these touch.

    Parameters
    ----------
    team: its drones and loads; its tensions and cable lengths, if they are not inputs.
    separation: with the ellipsoid of the drones' downwash; None for the default.
    roll: whether legs may roll out of the plane.
    tensions: whether tensions are inputs.
    cables: whether cable lengths are inputs.
    pairs: (pairs, 2) indices of drones for ``separations``; None for all pairs.

    Raises
    ------
    InputError: the team has no cables, or an index is not one of its drones.
    """
    import casadi as ca

    check_instance("team", team, Team)
    if not team.has_cables:
        raise InputError("team", team, "a team with cables", "model single drones on their own")
    flag("roll", roll)
    flag("tensions", tensions)
    flag("cables", cables)
    first, second = _pairs(team.drones, pairs)
    sizes = {"vertices": 3 * team.layout.points, "q_legs": team.robots}
    if roll:
        sizes["roll"] = len(team.layout.clasps)
    if tensions:
        sizes["tensions"] = team.robots
    values = _symbols(sizes)
    rates = _symbols({f"{SINGULAR[name]}_velocities": size for name, size in sizes.items()})
    curvatures = _symbols({f"{SINGULAR[name]}_accelerations": size for name, size in sizes.items()})
    constants = _symbols({"cable_lengths": team.robots} if cables else {})
    columns = zip(values.values(), rates.values(), curvatures.values(), strict=True)

    hitch = _Statics.of(team, values | constants)
    motion = _motion(hitch.positions, [ca.horzcat(*jet) for jet in columns])
    thrusts = _thrusts(ca.DM(team.mass), motion["accelerations"], hitch.cable_forces)
    scale = ca.DM((separation or Separation()).for_drones(team).scale)
    offsets = hitch.positions[:, first] - hitch.positions[:, second]
    outputs = {
        **{name: ca.vec(rate) for name, rate in motion.items()},
        "thrusts": ca.vec(thrusts),
        "tilt_cosines": (thrusts[2, :] / _lengths(thrusts)).T,
        "legs": hitch.legs,
        "cable_residuals": hitch.cable_residuals,
        "clasp_residuals": ca.vec(hitch.clasp_residuals),
        "exterior_angles": hitch.exterior_angles,
        "separations": _lengths(ca.repmat(scale, 1, len(first)) * offsets).T,
    }
    inputs = values | rates | curvatures | constants
    return ca.Function(
        "hitch", [*inputs.values()], [*outputs.values()], [*inputs], [*outputs], {"cse": True}
    )


def _symbols(sizes: Mapping[str, int]) -> dict[str, ca.SX]:
    """Return columns of symbols by name."""
    import casadi as ca

    return {name: ca.SX.sym(name, size) for name, size in sizes.items()}


def _pairs(drones: int, pairs: ArrayLike | None) -> tuple[list[int], list[int]]:
    """Return the first and the second drones of pairs (m, 2), or of all pairs."""
    if pairs is None:
        first, second = np.triu_indices(drones, 1)
    else:
        given = np.asarray(pairs)
        is_index = given.ndim == 2 and given.shape[1] == 2 and given.dtype.kind == "i"
        if not is_index or not np.all((given >= 0) & (given < drones)):
            bound = f"pairs of indices of drones, from 0 to {drones - 1}"
            raise InputError("pairs", pairs, bound, "drones are in the order q0, r0, q1, …")
        first, second = given.T
    return first.tolist(), second.tolist()


@dataclass(frozen=True, eq=False)
class _Statics:
    """A hitch without its motion, as casadi expressions."""

    positions: ca.SX  # (3, 2n) [m], positions of drones
    cable_forces: ca.SX  # (3, 2n) [N], forces of cables on drones
    legs: ca.SX  # (2n, 1) [m], distances of drones from their vertices; 0 at a chain's ends
    cable_residuals: ca.SX  # (n, 1) [m], lengths of legs and edge minus that of the cable
    clasp_residuals: ca.SX  # (3, clasps) [N], sums of all forces on a clasp
    exterior_angles: ca.SX  # (clasps, 1) [rad], positive where the polygon is convex

    @classmethod
    def of(cls, team: Team, state: Mapping[str, ca.SX]) -> Self:
        """Return the hitch of the values of the inputs of ``model``."""
        import casadi as ca

        layout = team.layout
        n = team.robots
        points = ca.reshape(state["vertices"], 3, layout.points)
        q_legs = state["q_legs"].T
        tensions = state.get("tensions", ca.SX(team.tension)).T
        lengths = state.get("cable_lengths", ca.SX(team.cable_length)).T
        weighted = team.cable_density > 0.0
        weight = GRAVITY * team.cable_density
        behind = layout.behind.tolist()
        ahead = layout.ahead.tolist()
        clasp = clasp_function(
            weighted=weighted,
            loaded=bool(np.any(team.load)),
            rolled="roll" in state,
            equal="tensions" not in state and bool(np.ptp(team.tension) == 0.0),
        )
        clasps = clasp.map(len(behind))(
            points=ca.vertcat(
                points[:, layout.starts[layout.behind].tolist()],
                points[:, layout.clasps.tolist()],
                points[:, layout.ends[layout.ahead].tolist()],
            ),
            q_legs=ca.vertcat(q_legs[:, behind], q_legs[:, ahead]),
            tensions=ca.vertcat(tensions[:, behind], tensions[:, ahead]),
            roll=state["roll"].T if "roll" in state else 0.0,
            cable_length=lengths[:, behind],
            load=GRAVITY * team.load[None],
            weight=weight,
        )
        positions = points[:, layout.anchors.tolist()]  # final at a chain's ends, without legs
        positions[:, (2 * layout.behind + 1).tolist()] = clasps["r"]
        positions[:, (2 * layout.ahead).tolist()] = clasps["q"]
        parts = _leg_function(weighted=weighted).map(2 * n)(
            span=positions - points[:, layout.pulled_to.tolist()],
            tension=tensions[:, np.repeat(np.arange(n), 2).tolist()],
            weight=weight,
        )
        edges = _leg_function(weighted=weighted).map(n)(
            span=points[:, layout.ends.tolist()] - points[:, layout.starts.tolist()],
            tension=tensions,
            weight=weight,
        )
        has_leg = ca.DM(layout.has_leg.ravel().astype(np.float64)).T
        legs = ca.reshape(has_leg * parts["length"], 2, n)
        cables = legs[0, :] + edges["length"] + legs[1, :]
        return cls(
            positions=positions,
            cable_forces=parts["force"],
            legs=(has_leg * parts["chord"]).T,
            cable_residuals=(cables - lengths).T,
            clasp_residuals=clasps["residual"],
            exterior_angles=ca.atan2(clasps["turn"], clasps["straight"]).T,
        )


def _lengths(columns: ca.SX) -> ca.SX:
    """Return the lengths (1, count) of columns (3, count)."""
    import casadi as ca

    return ca.sqrt(ca.sum1(columns * columns))
