"""Stated tensions of a plan, weights of cables that it omits, and loads of objects on its clasps.

An object of mass m rests with its rim on all clasps of a hitch that moves with it. Clasp k carries
the share ``μ_k`` of its mass, with ``Σ μ_k = 1`` and ``Σ μ_k p_k`` below its centre of mass. Of all
such shares, these have the least sum of squares, as those of equally stiff supports. If the centre
of mass is h above the clasps, its acceleration a adds the force ``m h G_k·a`` at clasp k.

Clasps are inside the rim, and the rim's edge bends their legs: below the rim they are horizontal,
beyond it they rise, on average by an angle φ with ``sin φ = W / (2 Σ T_k)``, W the weight of object
and edges. The rim takes the share ``1 - cos φ`` of edges' pulls. Vertices, where straight legs
would meet, are below the rim by the mean leg's slope times its distance from the rim's edge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.controllers import RECORDED_TUBE, Tube
from hitchopt.drones.quadrotor import LARGEST_DEFAULT, MODELS, usual_ellipsoid
from hitchopt.errors import InputError
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT, HoldBy, Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT, in_frame
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

TENSION_ROUNDING = 1e-9
"""Relative difference from the smallest stated tension at which a cable counts as taut."""


def ranged_phases(motion: Motion) -> NDArray[np.intp]:
    """Return the index (pieces,) of the phase whose range of tensions applies, else -1.

    A range applies to pieces that lie entirely within its phase.
    """
    starts = motion.drones.breaks[:-1]
    ends = motion.drones.breaks[1:]
    ranged = np.full(motion.drones.pieces, -1, dtype=np.intp)
    for index, phase in enumerate(motion.phases):
        if phase.tension is not None:
            is_within = (starts >= phase.start - JOINT) & (ends <= phase.end + JOINT)
            ranged[is_within] = index
    return ranged


def stated_tensions(motion: Motion) -> Array:
    """Return the smallest and largest tension (pieces, n, 2) [N] stated by each piece's phase.

    Both are the team's tension if the phase states no range.
    """
    ranged = ranged_phases(motion)
    of_team = np.repeat(motion.team.tension[:, None], 2, axis=1)
    stated = np.tile(of_team, (motion.drones.pieces, 1, 1))
    for index, phase in enumerate(motion.phases):
        if phase.tension is not None:
            stated[ranged == index] = phase.tension
    return stated


RIM_CUT = 0.005
"""[m] Largest height above a rim at which straight legs below it leave its outline.

Legs bend at the rim's edge, by angles of their own; vertices are below it for their mean.
"""

RIM_REMEDY = (
    f"keep legs below the rim: they leave it more than {1e3 * RIM_CUT:g} mm above its edge, "
    "where they bend"
)

USUAL_DENSITY = 0.01
"""[kg/m] Density of a cord of 4 mm, which drones without a model are assumed to have."""


def weightless_notes(flight: Flight, request: object) -> Iterator[str]:
    """Yield a note for every hitch whose problem does not state the density of its cables.

    It says how much lower vertices hang with the cables of its drones' models, or USUAL_DENSITY.
    ``request`` is the content of the problem file; if it is None, a density of 0 is not stated.
    """
    for flown in flight.teams:
        motion = flown.motion
        key = f"teams.{flown.name}" if flown.name else "team"
        section = request
        for name in key.split("."):
            section = section.get(name) if isinstance(section, dict) else None
        is_stated = isinstance(section, dict) and "cable_density" in section
        if is_stated or not np.any(motion.formed) or motion.team.cable_density > 0.0:
            continue
        models = [MODELS[kind.model] if kind.model else None for kind in motion.team.quadrotor]
        density = max(USUAL_DENSITY if model is None else model.cable_density for model in models)
        drop = float(np.max(sags(motion, density)))
        cables = f"cables of {flown.name}" if flown.name else "cables"
        yield (
            f"{cables} are assumed weightless; at {1e3 * density:g} g/m vertices would hang "
            f"{100.0 * drop:.2g} cm lower: state {key}.cable_density"
        )


def ellipsoid_notes(flight: Flight, request: object) -> Iterator[str]:
    """Yield a note for every team with heavy drones whose problem does not state an ellipsoid.

    Such an ellipsoid is the default one, or that of a named model. ``request`` is the content of
    the problem file; if it is None, an ellipsoid counts as stated unless it is the default one.
    """
    section = request.get("separation") if isinstance(request, dict) else None
    if isinstance(section, dict) and not {"radius", "height"}.isdisjoint(section):
        return
    default = Separation()
    for flown in flight.teams:
        motion = flown.motion
        ellipsoid = motion.requirements.separation
        mass = float(np.max(motion.team.mass))
        is_heavy = mass > LARGEST_DEFAULT
        radius, height = usual_ellipsoid(mass)
        is_small = ellipsoid.radius < radius or ellipsoid.height < height
        is_default = (ellipsoid.radius, ellipsoid.height) == (default.radius, default.height)
        is_unstated = is_default or request is not None  # a request with axes has returned above
        if is_heavy and is_small and is_unstated:
            drones = f"drones of {flown.name}" if flown.name else "drones"
            yield (
                f"{drones} weigh up to {mass:g} kg, but have the default ellipsoid "
                f"({ellipsoid.radius:g} m, {ellipsoid.height:g} m); that of x260_bolt, scaled to "
                f"this mass, has {radius:g} m and {height:g} m: state separation.radius and "
                "separation.height"
            )


def assumption_notes(flight: Flight, request: object) -> Iterator[str]:
    """Yield a note for every held object whose mass or friction the problem does not state.

    ``request`` is the content of the problem file, or None.
    """
    sections = request.get("objects") if isinstance(request, dict) else None
    if not isinstance(sections, dict):
        return
    for flown in flight.teams:
        motion = flown.motion
        holds = [phase.hold for phase in motion.phases if phase.hold is not None]
        for name in dict.fromkeys(hold.object for hold in holds):
            section = sections.get(name)
            body = motion.requirements.objects[name]
            values = {
                "mass": f"a mass of {body.mass:g} kg",
                "friction": f"a coefficient of friction of {body.friction:g}",
            }
            missing = [key for key in values if isinstance(section, dict) and key not in section]
            if missing:
                assumed = " and ".join(values[key] for key in missing)
                yield f"objects.{name}: {assumed} assumed; state {' and '.join(missing)}"


LARGEST_TRIM = 0.05
"""[m] Trim above which drones swing by themselves: in the firmware's loop by at most 0.4 cm with
trims of 4 cm, and by 1.7 to 3.4 cm (standard deviations) with 8 cm."""


def tracking_warnings(flight: Flight) -> Iterator[str]:
    """Yield warnings for every team: a tracking error below its controllers', and large trims."""
    for flown in flight.teams:
        motion = flown.motion
        warnings = [motion.requirements.understated_tracking(motion.team)]
        trim = float(np.max(length(motion.team.trim)))
        if trim > LARGEST_TRIM:
            warnings.append(
                f"trims of up to {100.0 * trim:.3g} cm: motion capture defines a rigid body so "
                "tilted that its drone swings by itself, by 2 to 3 cm at 8 cm; define it level"
            )
        for warning in filter(None, warnings):
            yield f"{flown.name}: {warning}" if flown.name else warning


def sags(motion: Motion, density: float) -> Array:
    """Return the depth of clasps (pieces, clasps) [m] below a hitch of weightless cables.

    Pieces are those on which the hitch exists, at their starts. The weight of half of all parts
    that end at a clasp bears on its two legs, of lengths d and e; edges stay horizontal:

        z (T_d / d + T_e / e) = ρ g (d + e + l + l') / 2,

    for a regular hitch ``z = ρ g d (l + d) / 2T``.
    """
    layout = motion.team.layout
    formed = motion.formed
    points = motion.vertices.coefficients[formed, ..., 0]
    edges = length(layout.edges(points))
    cables = np.stack([layout.ahead, layout.behind])  # of a clasp's q- and r-leg
    legs = motion.legs.coefficients[formed][:, cables, [[0], [1]], 0]
    weight = 0.5 * GRAVITY * density * np.sum(legs + edges[:, cables], axis=1)
    stiffness = np.sum(motion.team.tension[cables] / legs, axis=1)
    return np.asarray(weight / stiffness)


def tautness(motion: Motion) -> Array:
    """Return the tautness of cables (pieces, n, degree + 1), from 0 (hanging free) to 1 (straight).

    It is the weight with which forces blend from those of a hanging cable to those of a taut one
    (``forces.cable_forces``): ``T / T_stated``, T_stated the smallest tension of the phase, each
    Bernstein coefficient clipped to [0, 1]. Free cables have 0. As a polynomial it is continuous
    wherever tensions are. Ramps end at T_stated, as the check ``tension`` verifies.
    """
    lowest = stated_tensions(motion)[..., :1]
    shares = motion.tensions.coefficients / ((1.0 - TENSION_ROUNDING) * lowest)
    return np.where(motion.pulling[:, None, None], np.clip(shares, 0.0, 1.0), 0.0)


def ramping(motion: Motion) -> NDArray[np.bool_]:
    """Return on which pieces (pieces,) tensions of a hitch rise from or fall to those of no hitch.

    Weights are scaled there with the tensions, so that no force jumps; real cables sag more, and
    their vertices are lower.
    """
    return np.asarray(motion.formed & np.any(tautness(motion) < 1.0, axis=(1, 2)))


def leg_tensions(motion: Motion) -> Array:
    """Return legs' tensions at their inner ends (pieces, 2n, degree + 1) [N]; 0 if free."""
    return np.where(motion.pulling[:, None, None], motion.pulls.coefficients, 0.0)


def reduce_constants(coefficients: Array) -> Array:
    """Return constants in degree 0, where products are cheaper; other polynomials unchanged."""
    first = coefficients[..., :1]
    return first if np.logical_and.reduce(coefficients == first, axis=None) else coefficients


@dataclass(frozen=True, eq=False)
class Supports:
    """Distribution of an object's weight over the clasps below it."""

    shares: Array  # (…, clasps), fractions ``μ_k`` of its mass
    gains: Array
    """(…, clasps, 2) [1/m], ``G_k``: derivatives of the shares with respect to the point at which
    the force line meets the clasps' plane, in the object's frame."""

    @classmethod
    def at(cls, points: Array, centre: Array) -> Supports:
        """Return the distribution over points (…, clasps, 2) [m] below a centre (2,) [m]."""
        offsets = points - centre
        rows = np.concatenate([np.ones_like(offsets[..., :1]), offsets], axis=-1)
        solution = np.swapaxes(np.linalg.pinv(rows), -1, -2)  # (…, clasps, 3)
        return cls(shares=solution[..., 0], gains=solution[..., 1:])


def supports_of(motion: Motion, index: int, body: SolidObject) -> Supports:
    """Return the distribution of an object's weight at the start of each piece."""
    clasps = _local_vertices(motion, index)[:, motion.team.layout.clasps]
    return Supports.at(clasps, body.centre_of_mass[:2])


def _local_vertices(motion: Motion, index: int) -> Array:
    """Return vertices (pieces, points, 2) [m] in an object's frame at the start of each piece."""
    poses = motion.poses.coefficients[:, index, :, 0]
    return in_frame(poses[:, None], motion.vertices.coefficients[..., 0])[..., :2]


def object_loads(motion: Motion) -> Array | None:
    """Return the forces ``w_k`` (pieces, clasps, 3, …) [N] of objects on clasps; None if zero."""
    loads: list[Array] = []
    for resting in _resting_objects(motion):
        supports = supports_of(motion, resting.index, resting.body)
        is_held = resting.held[:, None, None, None]
        loads.append(np.where(is_held, _inertial_loads(motion, resting, supports), 0.0))
        loads.append(np.where(is_held, _tilting_loads(motion, resting, supports), 0.0))
    return _total(loads)


def _inertial_loads(motion: Motion, resting: RestingObject, supports: Supports) -> Array:
    """Return the shares of weight and inertia (pieces, clasps, 3, …) [N] on clasps.

    Each clasp accelerates its share of the mass as it moves itself.
    """
    body = resting.body
    accelerations = motion.vertices.differentiated(2).coefficients[:, motion.team.layout.clasps]
    accelerations = np.where(resting.moves[:, None, None, None], accelerations, 0.0)
    order = max(bernstein.degree(accelerations), bernstein.degree(resting.load_share))
    specific_forces = bernstein.elevate(accelerations, order).copy()
    specific_forces[:, :, 2] += GRAVITY * bernstein.elevate(resting.load_share, order)[:, None]
    return -body.mass * supports.shares[..., None, None] * specific_forces


def _tilting_loads(motion: Motion, resting: RestingObject, supports: Supports) -> Array:
    """Return the forces ``m h G_k·a ẑ`` (pieces, clasps, 3, …) [N] on clasps.

    They balance the moment of the inertia of a centre of mass that is h above the clasps.
    """
    body = resting.body
    pose = resting.pose
    rim_height = 0.0 if body.rim is None else body.rim.height
    height = body.centre_of_mass[2] - rim_height
    acceleration = bernstein.differentiate(bernstein.differentiate(centre_path(pose, body)))
    horizontal = acceleration[:, :2] / motion.drones.durations[:, None, None] ** 2
    x, y = np.moveaxis(np.where(resting.moves[:, None, None], horizontal, 0.0), 1, 0)
    cosine, sine = np.moveaxis(reduce_constants(pose[:, 3:]), 1, 0)  # of yaw
    local_x = bernstein.multiply(x, cosine) + bernstein.multiply(y, sine)
    local_y = bernstein.multiply(y, cosine) - bernstein.multiply(x, sine)
    local = np.stack([local_x, local_y], axis=1)
    upward = body.mass * height * np.einsum("pkd,pdi->pki", supports.gains, local)
    level = np.zeros_like(upward)
    return np.stack([level, level, upward], axis=2)


def saved_lengths(motion: Motion) -> Array | None:
    """Return the reductions of cables' lengths by rims (pieces, n, degree + 1) [m]; None if zero.

    They grow with the square of the load share, like ``strut_shares``.
    """
    savings = list[Array]()
    for resting in _resting_objects(motion):
        if resting.body.rim is None or not motion.team.layout.closed:
            continue
        held = resting.held
        tensions = motion.tensions.coefficients[held, ..., 0]
        vertices = _local_vertices(motion, resting.index)[held]
        at_full_load = np.zeros((len(held), motion.team.robots))
        legs = rim_savings(motion.team, resting.body, vertices, tensions)
        at_full_load[held] = np.sum(legs, axis=-1)
        savings.append(at_full_load[..., None] * resting.squared_share[:, None])
    return _total(savings)


def strut_shares(motion: Motion) -> Array | None:
    """Return the fraction of edges' pulls that rims take (pieces, degree + 1); None if zero.

    It grows with the square of the load share, as ``1 - cos`` of the legs' slope does.
    """
    edges = length(motion.team.layout.edges(motion.vertices.coefficients[..., 0], axis=1))
    tensions = motion.tensions.coefficients[..., 0]
    shares = list[Array]()
    for resting in _resting_objects(motion):
        held = resting.held
        at_full_load = np.ones(len(held))
        mass = resting.body.mass
        at_full_load[held] = strut_share(motion.team, mass, edges[held], tensions[held])
        shares.append(at_full_load[:, None] * resting.squared_share)
    return _total(shares)


def held_pieces(motion: Motion, name: str, by: HoldBy) -> NDArray[np.bool_]:
    """Return on which pieces (pieces,) an object is held, either by rest or by grip."""

    def is_held(phase: Phase) -> bool:
        hold = phase.hold
        return hold is not None and hold.object == name and hold.by is by

    return motion.in_phases(is_held)


@dataclass(frozen=True, eq=False)
class RestingObject:
    """An object whose rim rests on clasps on some pieces of a motion."""

    index: int  # Its index
    body: SolidObject  # The object
    pose: Array  # (pieces, 5, degree + 1), x, y, z [m], cosine and sine of yaw
    held: NDArray[np.bool_]  # (pieces,), whether it rests on clasps
    load_share: Array  # (pieces, degree + 1), the fraction of its weight that clasps carry there

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(pieces,), whether it moves; else it may still stand on its support."""
        return np.asarray(np.any(np.ptp(self.pose, axis=-1) > REST_DRIFT, axis=-1))

    @property
    def squared_share(self) -> Array:
        """(pieces, 2 degree + 1), the square of the load share."""
        return bernstein.multiply(self.load_share, self.load_share)


def _resting_objects(motion: Motion) -> Iterator[RestingObject]:
    """Yield the objects that load clasps."""
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        held = held_pieces(motion, name, HoldBy.REST)
        load_share = np.where(held[:, None], motion.load_share.coefficients[:, index], 0.0)
        if np.any(load_share):
            yield RestingObject(index, body, motion.poses.coefficients[:, index], held, load_share)


def _total(parts: list[Array]) -> Array | None:
    """Return the sum of polynomials of any degrees; None if there are none."""
    order = max((bernstein.degree(part) for part in parts), default=0)
    elevated = [bernstein.elevate(part, order) for part in parts]
    return sum(elevated[1:], elevated[0]) if elevated else None


def _rise_angle(
    team: Team, mass: float, edges: Array, tensions: Array, load_share: Array | float = 1.0
) -> Array:
    """Return the mean rise angle φ (…) [rad] of legs, for lengths of edges (…, n) [m]."""
    weight = GRAVITY * (mass + team.cable_density * np.sum(edges, axis=-1))
    slope = load_share * weight / (2.0 * np.sum(tensions, axis=-1))
    return np.asarray(np.arcsin(np.minimum(slope, 1.0)))


def strut_share(team: Team, mass: float, edges: Array, tensions: Array) -> Array:
    """Return the share (…) of edges' pulls that the rim of an object of a mass [kg] takes.

    ``edges`` are lengths (…, n) [m], ``tensions`` (…, n) [N].
    """
    return np.asarray(1.0 - np.cos(_rise_angle(team, mass, edges, tensions)))


def rim_drop(
    team: Team, body: SolidObject, vertices: Array, tensions: Array, load_share: Array | float = 1.0
) -> Array:
    """Return the depth of vertices below a rim that rests on their legs (…) [m].

    From above, legs extend the two edges at their vertex. Vertices (…, n, 2) [m] are clockwise in
    the object's frame, with tensions (…, n) [N] and the share (…) of the weight on the legs.
    """
    distances = _distances_to_rim(body, vertices)
    angle = _rise_angle(team, body.mass, distances.edges, tensions, load_share)
    both_legs = distances.onward + distances.back
    return np.asarray(np.mean(both_legs, axis=-1) * 0.5 * np.tan(angle))


def rim_savings(team: Team, body: SolidObject, vertices: Array, tensions: Array) -> Array:
    """Return the excess of straight legs q and r over legs bent by a rim (…, n, 2) [m].

    Under the full weight, cables are horizontal up to the rim's edge and rise beyond it. Parameters
    are those of ``rim_drop``.
    """
    distances = _distances_to_rim(body, vertices)
    angle = _rise_angle(team, body.mass, distances.edges, tensions)
    excess = 1.0 / np.cos(angle) - 1.0
    # q_k extends edge k-1, r_k extends edge k+1.
    below_q = np.roll(distances.onward, 1, axis=-1)
    below_r = np.roll(distances.back, -1, axis=-1)
    return np.asarray(np.stack([below_q, below_r], axis=-1) * excess[..., None, None])


class RimDistances(NamedTuple):
    """Distances (…, n) [m] along the lines of edges that extend to a rim."""

    onward: Array  # Distances from the end of each edge to the rim's edge
    back: Array  # Distances from the start of each edge to the rim's edge
    edges: Array  # The lengths of edges


def _distances_to_rim(body: SolidObject, vertices: Array) -> RimDistances:
    """Return the distances of a polygon (…, n, 2) [m] in an object's frame."""
    if body.rim is None:
        raise InputError("rim", None, "given", "add a rim, or grasp it by: grip")
    reach = body.rim.section.reach
    next_vertices = np.roll(vertices, -1, axis=-2)
    edges = next_vertices - vertices
    along = unit(edges)
    return RimDistances(reach(next_vertices, along), reach(vertices, -along), length(edges))


def centre_path(pose: Array, body: SolidObject) -> Array:
    """Return the path of the centre of mass (pieces, 3, …) [m] for poses of its object."""
    x, y, z = body.centre_of_mass
    cosine = pose[:, 3]
    sine = pose[:, 4]
    offset = [cosine * x - sine * y, sine * x + cosine * y, np.full_like(cosine, z)]
    return np.asarray(pose[:, :3] + np.stack(offset, axis=1))


def tracking_notes(flight: Flight) -> Iterator[str]:
    """Yield a note if ``limits.tracking`` is the error of a simulated controller."""
    for each in flight.teams:
        tube = each.motion.requirements.limits.tube
        team = each.motion.team
        if team.tracking is None or Tube.of(team.tracking) != tube:
            continue
        if any(kind.controller and kind.tracking is None for kind in team.quadrotor):
            yield (
                f"distances hold if drones stay within {tube}; real drones in public logs were off "
                f"by {Tube(*RECORDED_TUBE)}: set limits.tracking to your measured error"
            )
            return
