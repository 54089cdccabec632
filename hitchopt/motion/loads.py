"""Stated tensions of a plan, weights of cables that it omits, and loads of objects on its clasps.

An object of mass m rests with its rim on all clasps of a hitch that moves with it. Clasp k carries
the share ``μ_k`` of its mass, with ``Σ μ_k = 1`` and ``Σ μ_k p_k`` below its centre of mass. Of all
such shares, these have the least sum of squares, as those of equally stiff supports. If the centre
of mass is h above the clasps, its acceleration a adds the force ``m h G_k·a`` at clasp k.

Clasps are inside the rim, and the rim's edge bends their legs: below the rim they are level, beyond
it they rise, on average by an angle φ with ``sin φ = W / (2 Σ T_k)``, W the weight of object and
edges. The rim takes the share ``1 - cos φ`` of edges' pulls. Vertices, where straight legs would
meet, are below the rim by the mean leg's slope times its distance from the rim's edge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.quadrotor import MODELS
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT, HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT, in_frame
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

TENSION_ROUNDING = 1e-9
"""Relative difference from the smallest stated tension at which a cable counts as taut."""


def ranged_phases(motion: Motion) -> NDArray[np.intp]:
    """Return the index (pieces,) of the phase whose range of tensions applies, else -1.

    A range applies to pieces that lie entirely within its phase.
    """
    starts, ends = motion.drones.breaks[:-1], motion.drones.breaks[1:]
    index = np.full(motion.drones.pieces, -1, dtype=np.intp)
    for i, phase in enumerate(motion.phases):
        if phase.tension is not None:
            index[(starts >= phase.start - JOINT) & (ends <= phase.end + JOINT)] = i
    return index


def stated_tensions(motion: Motion) -> Array:
    """Return the smallest and largest tension (pieces, n, 2) [N] stated by each piece's phase.

    Both are the team's tension if the phase states no range.
    """
    index, default = ranged_phases(motion), np.repeat(motion.team.tension[:, None], 2, axis=1)
    stated = np.tile(default, (motion.drones.pieces, 1, 1))
    for i, phase in enumerate(motion.phases):
        if phase.tension is not None:
            stated[index == i] = phase.tension
    return stated


RIM_CUT = 0.005
"""[m] Largest height above a rim at which straight legs below it leave its outline.

Legs bend at the rim's edge, by angles of their own; vertices are below it for their mean.
"""

RIM_REMEDY = (
    f"keep legs below the rim: they leave it more than {1e3 * RIM_CUT:g} mm above its edge, "
    "where they bend"
)

USUAL_DENSITY = 0.01  # Density of a cord of 4 mm [kg/m], of drones without a model


def weightless_notes(flight: Flight, problem: str = "") -> Iterator[str]:
    """Yield a note for every hitch whose problem does not state the density of its cables.

    It says how much lower vertices hang with the cables of its drones' models, or USUAL_DENSITY.
    ``problem`` is the text of the problem file; without it, a density of 0 is not stated.
    """
    data = parse_yaml(problem) if problem else None
    for flown in flight.teams:
        motion = flown.motion
        key = f"teams.{flown.name}" if flown.name else "team"
        section: object = data
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


def assumption_notes(flight: Flight, problem: str = "") -> Iterator[str]:
    """Yield a note for every held object whose mass or friction the problem does not state."""
    data = parse_yaml(problem) if problem else None
    sections = data.get("objects") if isinstance(data, dict) else None
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


def tracking_warnings(flight: Flight) -> Iterator[str]:
    """Yield a warning for every team whose stated tracking error is below its controllers'."""
    for flown in flight.teams:
        motion = flown.motion
        if warning := motion.requirements.understated_tracking(motion.team):
            yield f"{flown.name}: {warning}" if flown.name else warning


def sags(motion: Motion, density: float) -> Array:
    """Return the depth of clasps (pieces, clasps) [m] below a hitch of weightless cables.

    Pieces are those on which the hitch exists, at their starts. The weight of half of all parts
    that end at a clasp bears on its two legs, of lengths d and e; edges stay level:

        z (T_d / d + T_e / e) = ρ g (d + e + l + l') / 2,

    for a regular hitch ``z = ρ g d (l + d) / 2T``.
    """
    team, layout, formed = motion.team, motion.team.layout, motion.formed
    points = motion.vertices.coefficients[formed, ..., 0]
    edges = length(layout.edges(points))
    cables = np.stack([layout.ahead, layout.behind])  # of a clasp's q- and r-leg
    legs = motion.legs.coefficients[formed][:, cables, [[0], [1]], 0]
    weight = 0.5 * GRAVITY * density * np.sum(legs + edges[:, cables], axis=1)
    return np.asarray(weight / np.sum(team.tension[cables] / legs, axis=1))


def tautness(motion: Motion) -> Array:
    """Return the tautness of cables (pieces, n, degree + 1), from 0 (hanging free) to 1 (straight).

    It is the weight with which forces blend from those of a hanging cable to those of a taut one
    (``forces.cable_forces``): ``T / T_stated``, T_stated the smallest tension of the phase, each
    Bernstein coefficient clipped to [0, 1]. Slack cables have 0. As a polynomial it is continuous
    wherever tensions are. Ramps end at T_stated, as the check ``tension`` verifies.
    """
    lowest = stated_tensions(motion)[..., :1]
    shares = motion.tensions.coefficients / ((1.0 - TENSION_ROUNDING) * lowest)
    return np.where(motion.taut[:, None, None], np.clip(shares, 0.0, 1.0), 0.0)


def leg_tensions(motion: Motion) -> Array:
    """Return legs' tensions at their inner ends (pieces, 2n, degree + 1) [N]; 0 if slack."""
    return np.where(motion.taut[:, None, None], motion.pulls.coefficients, 0.0)


def reduce_constants(coefficients: Array) -> Array:
    """Return constants in degree 0, where products are cheaper; other polynomials unchanged."""
    first = coefficients[..., :1]
    return first if np.logical_and.reduce(coefficients == first, axis=None) else coefficients


@dataclass(frozen=True, eq=False)
class Supports:
    """Distribution of an object's weight over the clasps below it."""

    shares: Array  # (…, clasps), fractions of its mass
    # (…, clasps, 2) [1/m], ``G_k``: derivatives of the shares by the point at which the force line
    # meets the clasps' plane, in the object's frame
    gains: Array

    @classmethod
    def at(cls, points: Array, centre: Array) -> Supports:
        """Return the distribution over points (…, clasps, 2) [m] below a centre (2,) [m]."""
        offsets = points - centre
        rows = np.concatenate([np.ones_like(offsets[..., :1]), offsets], axis=-1)
        gains = np.swapaxes(np.linalg.pinv(rows), -1, -2)  # (…, clasps, 3)
        return cls(gains[..., 0], gains[..., 1:])


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
    for index, body, held, share in _resting_objects(motion):
        pose = motion.poses.coefficients[:, index]
        supports = supports_of(motion, index, body)
        moving = np.any(np.ptp(pose, axis=-1) > REST_DRIFT, axis=-1)[:, None, None, None]
        accelerations = motion.vertices.differentiated(2).coefficients[:, motion.team.layout.clasps]
        accelerations = np.where(moving, accelerations, 0.0)  # at rest on its support
        order = max(bernstein.degree(accelerations), bernstein.degree(share))
        specific_forces = bernstein.elevate(accelerations, order).copy()
        specific_forces[:, :, 2] += GRAVITY * bernstein.elevate(share, order)[:, None]
        inertial = -body.mass * supports.shares[..., None, None] * specific_forces
        acceleration = bernstein.differentiate(bernstein.differentiate(centre_path(pose, body)))
        horizontal = acceleration[:, :2] / motion.drones.durations[:, None, None] ** 2
        x, y = np.moveaxis(np.where(moving[..., 0], horizontal, 0.0), 1, 0)
        c, s = np.moveaxis(reduce_constants(pose[:, 3:]), 1, 0)  # into the object's frame
        along = bernstein.multiply(x, c) + bernstein.multiply(y, s)
        local = np.stack([along, bernstein.multiply(y, c) - bernstein.multiply(x, s)], axis=1)
        height = body.centre_of_mass[2] - (0.0 if body.rim is None else body.rim.height)
        shift = body.mass * height * np.einsum("pkd,pdi->pki", supports.gains, local)
        tilting = np.stack([0.0 * shift, 0.0 * shift, shift], axis=2)
        loads += [np.where(held[:, None, None, None], part, 0.0) for part in (inertial, tilting)]
    return _total(loads)


def saved_lengths(motion: Motion) -> Array | None:
    """Return the reductions of cables' lengths by rims (pieces, n, degree + 1) [m]; None if zero.

    They grow with the square of the load share, like ``strut_shares``.
    """
    savings, n = list[Array](), motion.team.robots
    for index, body, held, load_share in _resting_objects(motion):
        if body.rim is None or not motion.team.layout.closed:
            continue
        full, pulls = np.zeros((len(held), n)), motion.tensions.coefficients[held, ..., 0]
        vertices = _local_vertices(motion, index)[held]
        full[held] = np.sum(rim_savings(motion.team, body, vertices, pulls), axis=-1)
        savings.append(full[..., None] * bernstein.multiply(load_share, load_share)[:, None])
    return _total(savings)


def strut_shares(motion: Motion) -> Array | None:
    """Return the fraction of edges' pulls that rims take (pieces, degree + 1); None if zero.

    It grows with the square of the load share, as ``1 - cos`` of the legs' slope does.
    """
    edges = length(motion.team.layout.edges(motion.vertices.coefficients[..., 0], axis=1))
    pulls, shares = motion.tensions.coefficients[..., 0], []
    for _, body, held, load_share in _resting_objects(motion):
        full = np.ones(len(held))
        full[held] = strut_share(motion.team, body.mass, edges[held], pulls[held])
        shares.append(full[:, None] * bernstein.multiply(load_share, load_share))
    return _total(shares)


def held_pieces(motion: Motion, name: str, by: HoldBy) -> NDArray[np.bool_]:
    """Return on which pieces (pieces,) an object is held, either by rest or by grip."""
    holds = [p.hold is not None and (p.hold.object, p.hold.by) == (name, by) for p in motion.phases]
    return np.array([*holds, False])[motion.phase_of_piece]


def _resting_objects(motion: Motion) -> Iterator[tuple[int, SolidObject, NDArray[np.bool_], Array]]:
    """Yield objects on clasps: index, object, mask of the pieces (pieces,), and load share."""
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        held = held_pieces(motion, name, HoldBy.REST)
        load_share = np.where(held[:, None], motion.load_share.coefficients[:, index], 0.0)
        if np.any(load_share):
            yield index, body, held, load_share


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
    onward, back, edges = _distances_to_rim(body, vertices)
    angle = _rise_angle(team, body.mass, edges, tensions, load_share)
    return np.asarray(np.mean(onward + back, axis=-1) * 0.5 * np.tan(angle))


def rim_savings(team: Team, body: SolidObject, vertices: Array, tensions: Array) -> Array:
    """Return the excess of straight legs q and r over legs bent by a rim (…, n, 2) [m].

    Under the full weight, cables are level up to the rim's edge and rise beyond it. Parameters are
    those of ``rim_drop``.
    """
    onward, back, edges = _distances_to_rim(body, vertices)
    excess = 1.0 / np.cos(_rise_angle(team, body.mass, edges, tensions)) - 1.0
    spans = np.stack([np.roll(onward, 1, axis=-1), np.roll(back, -1, axis=-1)], axis=-1)
    return np.asarray(spans * excess[..., None, None])


def _distances_to_rim(body: SolidObject, vertices: Array) -> tuple[Array, Array, Array]:
    """Return distances from edges' ends and starts to the rim, and edges' lengths (…, n) [m]."""
    if body.rim is None:
        raise InputError("rim", None, "given", "rest objects with a rim on clasps")
    next_vertices, reach = np.roll(vertices, -1, axis=-2), body.rim.section.reach
    along = unit(next_vertices - vertices)
    return reach(next_vertices, along), reach(vertices, -along), length(next_vertices - vertices)


def centre_path(pose: Array, body: SolidObject) -> Array:
    """Return the path of the centre of mass (pieces, 3, …) [m] for poses of its object."""
    x, y, z = body.centre_of_mass
    c, s = pose[:, 3], pose[:, 4]
    offset = np.stack([c * x - s * y, s * x + c * y, np.full_like(c, z)], axis=1)
    return np.asarray(pose[:, :3] + offset)
