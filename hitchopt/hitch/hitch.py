"""A hitch at rest: outline, legs and tensions determine every drone's position and force."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import Circumstance, InfeasibleError, InputError, Violation, short
from hitchopt.geometry import ConvexArc, ConvexPolygon, Outline
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.forces import (
    cable_forces,
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    weight_ratios,
)
from hitchopt.hitch.least_roll import least_roll, split_with_least_roll
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.hitch.slack_split import LIMIT_MARGIN, SPREAD_MARGIN, LegTask
from hitchopt.hitch.team import Team
from hitchopt.values import Array, ByValue, Points, as_array, check_instance, counted
from hitchopt.values.fields import store, suggest_keywords
from hitchopt.values.units import PLACED_ALTITUDE

LEG_TOLERANCE = 1e-4
"""Tolerance of a prescribed leg at a chain's end, relative to the length of its massless cable:
that of cable lengths in plans."""

SAGGING_LEG_TOLERANCE = 1e-2
"""The same tolerance for a heavy cable, whose sag the user may have neglected."""

ALTITUDE_TOLERANCE = 1e-9  # [m] Altitudes that differ by less are the same
UNIT_ERROR_RATIO = 100.0  # Edge over cable beyond which one of the two is probably in another unit

OR_OPEN = "use three, or an open chain (topology: open)"  # Remedy for two robots


def checked_polygon(team: Team, polygon: Outline | Points) -> Outline:
    """Return ``polygon`` as an outline with the team's topology and count, or raise InputError."""
    check_instance("team", team, Team)
    closed = team.layout.closed
    points = team.layout.points
    if closed and team.robots == 2:
        raise InputError("robots", 2, "at least 3 if cables hold a polygon", OR_OPEN)
    if not isinstance(polygon, Outline):
        polygon = ConvexPolygon(polygon) if closed else ConvexArc(polygon)
    if polygon.closed != closed:
        kind = "ConvexPolygon" if closed else "ConvexArc"
        bound = f"a {kind}, since the team is {team.topology}"
        remedy = "list its points accordingly, or change team.topology"
        raise InputError("polygon", polygon.vertices.tolist(), bound, remedy)
    if len(polygon) != points:
        count = "one per robot" if closed else "one more than robots"
        raise count_error("polygon", len(polygon), points, count)
    return polygon


def count_error(key: str, given: int, needed: int, count: str) -> InputError:
    """Return the error of a number of points that does not fit a team's robots.

    ``count`` says what the needed number is, such as one per robot.
    """
    bound = f"{counted(needed, 'point')}, {count}"
    counts = Circumstance(f"{counted(given, 'point')}, not {needed}, {count}")
    change = "remove" if given > needed else "add"
    return InputError(key, counts, bound, f"{change} points, or change team.robots")


def cable_slack(team: Team, polygon: Outline) -> Array:
    """Return (n,) [m] ``L_k - l_k``, or raise InfeasibleError if an edge uses up its cable.

    The cable of a sagging edge is longer than the edge (``forces``).
    """
    slack = cable_slack_of(team, polygon.edge_vectors)
    shortest = int(slack.argmin())
    if slack[shortest] > 0.0:
        return slack
    edge_length = polygon.edge_lengths[shortest]
    cable_length = team.cable_length[shortest]
    remedy = "shorten the edge or lengthen the cable"
    if edge_length < cable_length:
        remedy = "it sags under its weight: raise team.tension or lower team.cable_density"
    facts = f"edge {shortest} is {edge_length:.6g} m long on a cable of {cable_length:.6g} m"
    remedy = f"{facts}: {remedy}"
    if edge_length > UNIT_ERROR_RATIO * cable_length:
        remedy += f"; if millimetres were meant, {1e-3 * edge_length:.3g} m"
    # Sags of edges that are longer than their cables mean nothing.
    needed = edge_length if edge_length > cable_length else cable_length - slack[shortest]
    raise _refusal(needed, cable_length, "max", f"edge {shortest}", remedy)


def balanced_legs(team: Team, polygon: Outline) -> Array:
    """Return ``d_k`` (n,) [m]: half of the slack, or the only possible leg at a chain's ends."""
    slack = cable_slack(team, polygon)
    return team.layout.q_legs_of(0.5 * slack, slack)


def checked_legs(team: Team, q_legs: Array, slack: Array) -> Array:
    """Return the q-legs, exact at a chain's ends, or raise InfeasibleError."""
    layout = team.layout
    names = team.drone_names
    exact = layout.q_legs_of(q_legs, slack)
    worst = int((np.abs(q_legs - exact) / team.cable_length).argmax())
    tolerance = LEG_TOLERANCE if team.cable_density == 0.0 else SAGGING_LEG_TOLERANCE
    if abs(q_legs[worst] - exact[worst]) > tolerance * team.cable_length[worst]:
        sense = "max" if q_legs[worst] > exact[worst] else "min"
        drone = names[2 * worst + int(layout.has_leg[worst, 0])]
        place = f"{drone} is at the chain's end, without a leg"
        remedy = f"{place}: write d_{worst} = {exact[worst]:.9g}"
        raise _refusal(q_legs[worst], exact[worst], sense, names[2 * worst], remedy)
    both_legs = np.stack([exact, slack - exact], axis=1)
    existing_legs = np.where(layout.has_leg, both_legs, np.inf)
    cable, end = divmod(int(existing_legs.argmin()), 2)
    shortest = existing_legs[cable, end]
    if shortest <= 0.0:
        left = f"{team.cable_names[cable]} leaves {slack[cable]:.6g} m for both legs"
        remedy = f"{left}: keep d_{cable} within it"
        raise _refusal(shortest, 0.0, "min", names[2 * cable + end], remedy)
    return exact


def checked_roll(team: Team, roll: ArrayLike) -> Array:
    """Return the roll of every clasp (clasps,) [rad], read-only, or raise InputError."""
    clasps = len(team.layout.clasps)
    given = as_array("roll", roll)
    try:
        angles = np.array(np.broadcast_to(given, clasps))
    except ValueError:
        bound = f"one angle, or a list of {clasps} (one per clasp)"
        raise InputError("roll", roll, bound, "use radians") from None
    if not np.all(np.abs(angles) < 0.5 * np.pi):  # nan too
        raise InputError("roll", roll, "within ±π/2 rad", "use radians below a right angle")
    angles.setflags(write=False)
    return angles


def _refusal(value: float, limit: float, sense: str, where: str, remedy: str) -> InfeasibleError:
    """Return the error for a leg [m] beyond its limit."""
    violation = Violation("legs", float(value), float(limit), sense, "m", (where,), "", remedy)
    return InfeasibleError([violation])


def _frozen(array: Array) -> Array:
    """Return an array, made read-only."""
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Hitch(ByValue):
    """A hitch in static equilibrium, with all vertices in a horizontal plane.

    It is closed or an open chain. Legs rise out of the plane at clasps that carry weight; with roll
    one leg rises and the other descends.

    Parameters
    ----------
    team: its cables tie the hitch.
    polygon: its outline or the points, n of a closed hitch, n + 1 of a chain (points, 2) [m].
    altitude: height of its plane [m].
    q_legs: (n,) [m], ``d_k``: cable length from vertex k to drone q_k. The rest of cable k's slack
        is ``e_k = L_k - l_k - d_k``, from vertex k+1 to drone r_k. The ends of a chain are fixed:
        ``d_0 = 0`` and ``d_{n-1} = L_{n-1} - l_{n-1}``, to 1e-4 of the cable.
    roll: one or (clasps,) [rad], ``ψ_k``: angle of a clasp's legs out of the plane in which they
        hold it, with ``q_k`` up and ``r_{k-1}`` down if positive.

    Raises
    ------
    InputError: a count that does not match the team, or numbers that are not finite.
    InfeasibleError: an edge or legs that are too long for the cables, or a weight that the
        tensions cannot carry.
    """

    team: Team
    polygon: Outline
    altitude: float
    q_legs: Array
    roll: Array

    @suggest_keywords
    def __init__(
        self,
        team: Team,
        polygon: Outline | Points,
        altitude: float,
        q_legs: ArrayLike,
        roll: ArrayLike = 0.0,
    ) -> None:
        outline = checked_polygon(team, polygon)
        slack = cable_slack(team, outline)
        d = as_array("legs", q_legs)
        if d.shape != (team.robots,) or not np.all(np.isfinite(d)):
            bound = f"a list of {team.robots} finite lengths d_k"
            raise InputError("legs", q_legs, bound, "specify one per robot")
        d = checked_legs(team, d, slack)
        d.setflags(write=False)
        height = PLACED_ALTITUDE.check("altitude", altitude)
        angles = checked_roll(team, roll)
        values = {"team": team, "polygon": outline, "altitude": height, "q_legs": d, "roll": angles}
        store(self, **values)
        _ = self._directions  # raises where tensions cannot carry the loads

    def _parts(self) -> Iterator[str]:
        yield f"{self.team.robots} robots, {self.team.topology}"
        for name in ("altitude", "q_legs", "roll"):
            yield f"{name}={short(getattr(self, name))}"

    @classmethod
    @suggest_keywords
    def balanced(
        cls, team: Team, polygon: Outline | Points, altitude: float = 1.0, roll: ArrayLike = 0.0
    ) -> Hitch:
        """Return the hitch with ``d_k = e_k = (L_k - l_k)/2``, the paper's balanced configuration.

        At the ends of a chain, the cable's one leg takes all of its slack. Parameters and errors
        are those of the class.
        """
        outline = checked_polygon(team, polygon)
        return cls(team, outline, altitude, balanced_legs(team, outline), roll)

    @classmethod
    @suggest_keywords
    def spread(
        cls,
        team: Team,
        polygon: Outline | Points,
        altitude: float = 1.0,
        *,
        limits: Limits | None = None,
        separation: Separation | None = None,
        roll: ArrayLike | None = None,
    ) -> Hitch:
        """Return the hitch whose leg lengths separate the drones with a margin.

        Of all leg lengths within limits with separations and cable clearances of at least 1.5 times
        their limits, it has the nearest to balanced ones (least squares in ``d``). If there are
        none, it has the largest margin.

        Other parameters and errors are those of the class.

        Parameters
        ----------
        limits, separation: defaults if None; tracking errors add to the distances.
        roll: one or (clasps,) [rad]. None: no roll if the limits hold without it; otherwise the
        smallest
            angle, the same at all clasps, with which the margin holds, or at least the limits.
        """
        outline = checked_polygon(team, polygon)
        requirements = Requirements(limits or Limits(), separation or Separation())
        requirements = requirements.flown_by(team).with_reserve
        fixed = None if roll is None else checked_roll(team, roll)
        legs = balanced_legs(team, outline)
        task = LegTask.at_rest(team, outline, legs, requirements, SPREAD_MARGIN, fixed)
        split, rolled = split_with_least_roll(task) if fixed is None else (task.split(), fixed)
        return cls(team, outline, altitude, split.q_legs[0], rolled)

    @classmethod
    @suggest_keywords
    def nearest(
        cls,
        team: Team,
        polygon: Outline | Points,
        altitude: float,
        fractions: ArrayLike,
        *,
        limits: Limits,
        separation: Separation,
        arena: Arena | None = None,
        roll: ArrayLike = 0.0,
    ) -> Hitch:
        """Return the hitch whose slack split is nearest to ``fractions`` (n,) within every limit.

        If there is none, return the one with the largest margin. The roll, one or (clasps,) [rad],
        applies unless it breaks a limit: then all clasps have the smallest feasible one of the
        search. Errors are those of the class.
        """
        outline = checked_polygon(team, polygon)
        slack = cable_slack(team, outline)
        reference = team.layout.q_legs_of(np.asarray(fractions, dtype=np.float64) * slack, slack)
        requirements = Requirements(limits, separation, arena)
        angles = checked_roll(team, roll)
        task = LegTask.at_rest(team, outline, reference, requirements, LIMIT_MARGIN, angles)
        split, rolled = split_with_least_roll(task)
        return cls(team, outline, altitude, split.q_legs[0], rolled)

    def least_rolled(self, requirements: Requirements) -> Hitch:
        """Return the hitch with the same leg lengths and the smallest roll that keeps all limits.

        There is no roll if the limits hold without it, or if no roll helps.
        """
        task = LegTask.at_rest(self.team, self.polygon, self.q_legs, requirements, LIMIT_MARGIN)
        roll = None if task.reference_margin() >= 1.0 else least_roll(task)
        return Hitch(self.team, self.polygon, self.altitude, self.q_legs, roll or 0.0)

    def at_altitude(self, altitude: float) -> Hitch:
        """Return the hitch at another altitude [m]."""
        return Hitch(self.team, self.polygon, altitude, self.q_legs, self.roll)

    @cached_property
    def slack(self) -> Array:
        """(n,) [m]: slack of cable k for its two legs, ``L_k - l_k``, as cable length."""
        return _frozen(cable_slack(self.team, self.polygon))

    @property
    def r_legs(self) -> Array:
        """(n,) [m]: cable length ``e_k`` from vertex k+1 to drone r_k; 0 at a chain's end."""
        return self.team.layout.legs_of(self.q_legs, self.slack)[:, 1]

    @cached_property
    def legs(self) -> Array:
        """(n, 2) [m]: distances of q_k and r_k from their vertices, ``d_k`` and ``e_k``.

        They are zero at a chain's ends, and less than the cable lengths if cables sag.
        """
        if self.team.cable_density == 0.0:
            return _frozen(self.team.layout.legs_of(self.q_legs, self.slack))
        return _frozen(length(self._chords))

    @property
    def fractions(self) -> Array:
        """(n,): slack split ``d_k / (d_k + e_k)``."""
        return self.q_legs / self.slack

    @cached_property
    def vertices(self) -> Array:
        """(points, 3) [m]: n of a closed hitch, n + 1 of a chain."""
        vertices = np.full((len(self.polygon), 3), self.altitude)
        vertices[:, :2] = self.polygon.vertices
        return _frozen(vertices)

    @property
    def leg_directions(self) -> Array:
        """(2n, 3): unit vectors from the vertex to the drone, in the order q0, r0, q1, ….

        At a chain's ends, which have no leg, they point outward along the edge.
        """
        along_cables = np.stack(self._directions, axis=1)
        if self.team.cable_density == 0.0:
            return along_cables.reshape(-1, 3)
        return unit(self._chords, along_cables).reshape(-1, 3)

    @cached_property
    def _directions(self) -> tuple[Array, Array]:
        """Directions (n, 3) of the legs of q_k and of r_k at their vertices."""
        team = self.team
        loads = clasp_loads(team, self.slack, self.roll)
        edge_directions = np.zeros((team.robots, 3))
        edge_directions[:, :2] = self.polygon.edge_directions
        return leg_directions(edge_directions, team.tension, team.topology, loads)

    @cached_property
    def _chords(self) -> Array:
        """(n, 2, 3) [m]: vectors from vertices to q_k and r_k."""
        cables = self.team.layout.legs_of(self.q_legs, self.slack)
        along_cables = np.stack(self._directions, axis=1)
        return leg_vectors(
            cables, along_cables, weight_ratios(self.team, self.team.tension)[:, None]
        )

    @cached_property
    def drones(self) -> Array:
        """(2n, 3) [m]: ``q_k = p_k + d_k q̂_k`` and ``r_k = p_{k+1} + e_k r̂_k``."""
        anchors = self.vertices[self.team.layout.anchors]
        return _frozen(anchors + self._chords.reshape(-1, 3))

    @property
    def cable_forces(self) -> Array:
        """(2n, 3) [N]: force of the taut cable on each drone."""
        pulls = np.repeat(self.team.tension, 2)
        taut = np.ones(self.team.robots)
        points = self.vertices[self.team.layout.pulled_to]
        return cable_forces(self.team, self.drones, points, pulls, taut)
