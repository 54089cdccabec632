"""Objects: distances, supports, rims, and grips."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np

from .arithmetic import (
    BIG,
    POS_TOL,
    UP,
    Array,
    G,
    Index,
    Line,
    Mask,
    concatenate,
    maximum,
    minimum,
    norm,
    normalize,
)
from .cables import capstan, wrap_angle
from .catenary import lowest_height, shift
from .drones import FLOOR_ROW, wall_gap
from .plan import CONTACT_TOL, EXACT_RANGE, GROUNDED, WRAP_TOL, Plan
from .shapes import Slab, to_frame
from .spans import MIN_TENSION, Row, Spans, prove

RIM_CUT = 0.005  # [m] largest height above a rim at which legs that it bends leave its outline


def clear_objects(p: Plan, b: int) -> Iterator[Row]:
    """Prove distances of a body to cables, other bodies, ground and walls."""
    body = p.bodies[b]
    allowed = allowed_contacts(p, b)
    others = p.formed[:, None] & ~p.holding[b][:, p.segments[:, 2]]
    off = Spans.of(p, others, range(len(p.segments)), p.segment_names)
    free, clasping = (Spans.of(p, on, range(p.n), p.cables) for on in (p.free, p.clasping))
    moving, carried = (Spans.of(p, x[b], [0], [body.name]) for x in (p.moving, p.held))
    header = "penetration m min"

    def hanging_gap(s: Spans, k: Index, slab: Slab) -> Line:
        """Return heights of hanging cables above the body, or horizontal distances of chords."""
        height = (lowest_height(s, k) - p.poses.on(s, b)[2] - slab.upper) * (1.0 / p.ratio)
        height = height - shift(s, k)
        height = height.where(p.state[s.piece] != GROUNDED)
        return maximum(slab.enlarged(0.0, -BIG, BIG).gap(*s.ends(k, b)), height)

    def hull_gap(s: Spans, k: Index, slab: Slab) -> Line:
        *outline, lowest = s.hull(k, b)
        tall = slab.enlarged(0.0, -BIG, BIG)
        height = (lowest[2] - slab.upper) * (1.0 / p.ratio)
        return maximum(tall.gap(*outline, outline[0]), height)

    def arena_gap(s: Spans, _: Index, slab: Slab) -> Line:
        """Return distances to walls and ceiling; the floor is a contact."""
        top = [s.world(b, np.append(x, slab.upper)) for x in slab.core]
        return wall_gap(s, top, -BIG, slab.radius)

    def other_gap(s: Spans, _: Index, o: int, slab: Slab, block: Slab) -> Line:
        height = s.local(o, s.world(b, UP * slab.lower))[2] - block.upper
        touching = ((height + 2.0 * POS_TOL) * 1e6).where(allowed[s.piece, o])
        return maximum(body_gap(s, b, slab, s, o, block, p.ratio), touching)

    ground = -1, Slab(None, BIG, -BIG, p.floor)
    for slab in body.slabs:
        near = partial(slab.gap, ratio=p.ratio)
        yield prove(*p.object_limit, off, lambda s, j, near=near: near(*s.segment(j, b)))
        yield prove(*p.object_limit, free, partial(hanging_gap, slab=slab))
        reach = p.object_limit[1] + slab.radius + float(np.max(norm(slab.core))) + EXACT_RANGE
        place = p.poses.on(clasping, b)[:3]
        close = clasping.near_hulls(clasping.item[:, 0], place, reach)
        yield prove(*p.object_limit, close, partial(hull_gap, slab=slab))
        for o, block in (ground, *p.slabs):
            if o != b:
                gap = partial(other_gap, o=o, slab=slab, block=block)
                yield prove(*p.object_limit, moving, gap)
        if not body.fixed and p.arena is not None:  # columns may touch walls and ceiling
            yield prove("arena m min", 0.0, carried, partial(arena_gap, slab=slab))

    if not body.fixed and p.limits["floor"] is not None:
        everywhere = Spans.of(p, p.all_pieces, [0], [body.name])
        yield prove(FLOOR_ROW, p.limits["floor"], everywhere, lambda s, _: lowest_point(s, b))

    def inner_gap(s: Spans, _: Index, slab: Slab, o: int, block: Slab) -> Line:
        """Return the distance to a slightly smaller body, since surfaces may touch."""
        core = None if block.round else block.core + 1e-5 * (block.centroid - block.core)
        heights = block.lower + POS_TOL, block.upper - POS_TOL
        inner = Slab(core, (1.0 - 1e-5) * block.radius, *heights)
        return maximum(body_gap(s, b, slab, s, o, inner), body_gap(s, o, inner, s, b, slab))

    first = Spans.of(p, np.arange(len(p.h)) == 0, [0], [body.name]).subspan(-1.0)
    for slab, (o, block) in product(body.slabs, p.slabs):
        if o != b and block.upper > block.lower and not (body.fixed and p.bodies[o].fixed):
            gap = partial(inner_gap, slab=slab, o=o, block=block)
            yield prove(header, 0.5 * POS_TOL, first, gap)


def lowest_point(s: Spans, b: int) -> Line:
    """Return heights of the lowest points of body b; where it stands, that of the floor."""
    floor = s.plan.limits["floor"]
    height = s.plan.poses.on(s, b)[2] + min(slab.lower for slab in s.plan.bodies[b].slabs)
    stands = np.abs(height.v[:, 0] - floor) + height.deviation <= POS_TOL
    return height.where(~stands) + np.where(stands, floor, 0.0)[:, None]


def clear_held(p: Plan, b: int) -> Iterator[Row]:
    """Prove that cables which hold a body do not enter it, nor the ground.

    Edges touch a body that they grip: ``gripped`` proves how. A rim rests on cables only below it,
    up to RIM_CUT at its edge, which bends their legs.
    """
    body = p.bodies[b]
    header = "penetration m min"
    held = p.holding[b][:, p.segments[:, 2]] & p.formed[:, None]
    items = range(len(p.segments))
    wrapped = p.grip[b][:, None]
    is_leg = p.segments[:, 3] == p.segments[:, 4]
    is_tray = body.rim is not None and body.height == body.stem.lower  # above what it rests on
    masks = [held & (is_leg | ~wrapped) & (wrapped | (not is_tray)), held & wrapped]
    for slab, on in zip(body.slabs, masks, strict=False):
        s = Spans.of(p, on, items, p.segment_names)
        yield prove(header, WRAP_TOL, s, lambda s, j, slab=slab: slab.gap(*s.segment(j, b)))
    if body.rim is not None:
        s = Spans.of(p, held & p.rest[b][:, None], items, p.segment_names)
        cut = body.rim.enlarged(0.0, body.height + RIM_CUT, body.height + RIM_CUT)
        yield prove(header, WRAP_TOL, s, lambda s, j: cut.gap(*s.segment(j, b)))
    s = Spans.of(p, p.held[b], range(len(p.labels)), p.labels)
    yield prove(header, -WRAP_TOL, s, lambda s, i: s.point(i)[2] - p.floor)


def body_gap(
    s: Spans, b: int, slab: Slab, t: Spans, o: int, block: Slab, ratio: float = 1.0
) -> Line:
    """Return the distance of a slab of body b of spans s to a block of body o of spans t.

    Heights are divided by a ratio.
    """
    ring = [t.local(o, s.world(b, np.append(x, slab.lower))) for x in (*slab.core, slab.core[0])]
    lower = block.lower - slab.upper + slab.lower
    return block.enlarged(slab.radius, lower, block.upper).gap(*ring, ratio=ratio)


def allowed_contacts(p: Plan, b: int) -> Mask:
    """Return a mask of supports of a body by piece, the ground last, at lifts and descents."""
    c = p.poses.c[0]
    bottom = p.bodies[b].stem.lower
    vertical = np.all(np.ptp(c[:, b, [0, 1, 3, 4]], axis=-1) <= POS_TOL, axis=-1)
    runs = np.cumsum(~vertical)
    allowed = np.zeros((len(c), len(p.bodies) + 1), dtype=bool)
    for q, end in ((q, end) for q in np.flatnonzero(vertical) for end in (0, -1)):
        top, support = support_below(p, b, c[q, ..., end])
        if abs(c[q, b, 2, end] + bottom - top) <= POS_TOL or (q == 0 and end == 0):
            allowed[vertical & (runs == runs[q]), support] = True
    return allowed


def support_below(p: Plan, b: int, poses: Array) -> tuple[float, int]:
    """Return the height and the index of the support under a body (-1: the ground)."""
    c = poses[b]
    x, y, z = p.bodies[b].centre
    supports = [(p.floor, -1)]
    centre = c[:3] + [c[3] * x - c[4] * y, c[4] * x + c[3] * y, z]
    for o, other in enumerate(p.bodies):
        top = float(poses[o, 2] + other.stem.upper)
        inside = other.stem.depth(to_frame(poses[o], centre)[:2]) >= 0.0
        supports += [(top, o)] if o != b and inside and top <= centre[2] + POS_TOL else []
    return max(supports)


def resting(p: Plan, b: int) -> Iterator[Row]:
    """Prove that clasps keep their positions, and that friction and support hold the rim."""
    body = p.bodies[b]
    on = p.rest[b] & p.active[b]
    rim = p.bodies[b].rim
    if rim is None or not p.closed:
        return
    q = p.hold_start[b]
    places = to_frame(p.poses.c[0][q, b, None, :, 0], p.points.c[0][q, p.V, :, 0])

    def drift(s: Spans, j: Index) -> Line:
        """Return drifts of clasps since the start of the hold, and from depths below the rim."""
        x = s.local(b, s.point(p.begin[j]))
        at = places[s.piece, j]
        depth = p.rim.depth[b, s.piece, None]
        lifted = p.lifted[b, s.piece, None]
        upper = np.where(lifted, depth, 0.0) - rim.lower
        outside = np.where(rim.depth(at[:, :2]) > CONTACT_TOL, 0.0, 1.0)[:, None]
        return maximum((x[:2] - at[:, :2]).norm(), -x[2] + rim.lower - depth, x[2] + upper, outside)

    def friction_margin(s: Spans, j: Index) -> Line:
        a = s.point(p.begin[j], 2)
        return (a[2] + G) * body.friction - a[:2].norm()

    def support_margin(s: Spans, j: Index) -> Line:
        """Return ``n·(c - p_k) - h n·a / (g + a_z)`` of every side's inward normal n."""
        side = (places[s.piece, (j + 1) % p.n] - places[s.piece, j])[:, :2]
        n = normalize(np.stack([side[:, 1], -side[:, 0]], -1))
        a = s.rotated(b, s.world(b, body.centre, 2))
        x = s.local(b, s.point(p.begin[j]))
        lean = a[:2].dot(n) * (a[2] + G).inverse() * (float(body.centre[2]) - rim.lower)
        return (-x[:2] + body.centre[:2]).dot(n) - lean - 2.0 * CONTACT_TOL

    s, lifted = (Spans.of(p, x, range(p.n), p.labels[p.V]) for x in (on, on & p.lifted[b]))
    yield prove("rim m max", CONTACT_TOL, s, drift)
    yield prove("rim m/s² min", 0.0, s, friction_margin)
    yield prove("support m min", 0.0, lifted, support_margin)


def loaded_grip(p: Plan, b: int) -> Mask:
    """Return the pieces on which a body that edges grip is carried, in part or entirely."""
    return np.asarray(p.grip[b] & np.any(p.load_share.c[0][:, b, 0] > 0.0, axis=-1))


def gripped(p: Plan, b: int) -> Iterator[Row]:
    """Prove that edges around a gripped body hold it, balance it, and are tangent to it."""
    grip = Grip(p, b)
    name = [p.bodies[b].name]
    loaded = Spans.of(p, loaded_grip(p, b), [0], name)
    gripping = Spans.of(p, p.grip[b], [0], name)
    edges = Spans.of(p, p.grip[b], range(p.n), p.cables)
    moving = Spans.of(p, p.grip[b] & p.active[b], [0], name)
    yield prove("grip ratio min", 1.5, loaded, grip.ratio)
    yield prove("equilibrium ratio max", 5e-3, gripping, grip.residual)
    yield prove("wrap m max", 3 * WRAP_TOL, edges, grip.wrap_error)
    yield prove("wrap m max", CONTACT_TOL, moving, grip.rotation)


class Grip:
    """Formulas of edges around body b; contacts are in its frame."""

    def __init__(self, p: Plan, b: int) -> None:
        self.p = p
        self.b = b
        self.body = p.bodies[b]
        self.stem = p.bodies[b].stem
        self.contacts = p.edges[1:3].ravel()
        self.radius = float(np.max(norm(self.stem.core))) + self.stem.radius
        q = p.hold_start[b]
        contacts = p.points.c[0][q, ..., 0][:, self.contacts]
        self.start = to_frame(p.poses.c[0][q, b, None, :, 0], contacts)

    def ratio(self, s: Spans, _: Index) -> Line:
        """Return slip load ``μ Σ T_k e^{-μ' β} θ_k`` over load ``m (b (g + a_z) + α R² / r)``."""
        p = self.p
        slip = s.zero
        for k in range(p.n):
            weaker = (p.pulls.on(s, i) * capstan(s, i).inverse() for i in (2 * k, 2 * k + 1))
            slip = slip + wrap_angle(s, k) * minimum(*weaker) * self.body.friction
        arms = norm(self.stem.core - self.stem.centroid)
        turning = (np.max(arms) + self.stem.radius) ** 2 / (self.stem.radius or np.min(arms))
        a = p.poses.on(s, self.b, 2)
        weight = p.load_share.on(s, self.b) * (a[2] + G)
        load = (weight + a[3:].norm() * turning) * self.body.mass
        return slip * maximum(load, 1e-6).inverse()

    def residual(self, s: Spans, _: Index) -> Line:
        """Return force and moment residuals over the smallest tension, less ground friction."""
        p = self.p
        mass = self.body.mass
        lifted = p.lifted[self.b, s.piece]
        share = p.load_share.on(s, self.b)
        centre = s.world(self.b, self.body.centre)
        a = s.world(self.b, self.body.centre, 2).where(lifted)
        moment = s.zero * UP
        force = -(a + share * UP * G) * mass
        for k in range(p.n):
            leaving, arriving = s.edge(k)
            level = s.level_pull(k)[1]
            for end, u in ((0, -leaving.unit()), (1, arriving.unit())):
                pull = u * level
                moment = moment + (s.point(p.edges[1 + end, k]) - centre).cross(pull)
                force = force + pull
        friction = (-share + 1.0) * (self.body.friction * mass * G)
        push = concatenate(force[:2], moment[2] * (1.0 / self.stem.mean_radius)).norm() - friction
        standing = maximum(push, force[2].norm()).where(~lifted)
        flying = maximum(force.norm(), moment.norm() * (1.0 / self.radius)).where(lifted)
        tension = maximum(minimum(*(p.tensions.on(s, k) for k in range(p.n))), MIN_TENSION)
        return (flying + standing) * tension.inverse()

    def rotation(self, s: Spans, _: Index) -> Line:
        """Return the mean rotation against the contacts since the start of the hold [m]."""
        centroid = self.stem.centroid
        tangent = normalize(self.start[..., :2] - centroid)[..., ::-1] * [-1.0, 1.0]
        arms = [s.local(self.b, s.point(int(i)))[:2] - centroid for i in self.contacts]
        turns = sum((x.unit().dot(tangent[s.piece, j]) for j, x in enumerate(arms)), s.zero)
        return turns.norm() * (self.radius / len(self.contacts))

    def wrap_error(self, s: Spans, k: Index) -> Line:
        """Return errors of contacts, and depths of straight parts inside the section."""
        stem = self.stem
        ends = [s.local(self.b, s.point(i)) for i in self.p.edges[1:3, k]]
        leaving, arriving = s.edge(k)
        bend = norm(np.cross(normalize(leaving.v), normalize(arriving.v)))
        bent = (norm(ends[1].v - ends[0].v) > WRAP_TOL) | (bend > 2.0 * WRAP_TOL)
        errors = [leaving[0] * arriving[1] - leaving[1] * arriving[0]]  # [m²] turns to the left
        for x, edge in zip(ends, s.edge(k), strict=True):
            corner = stem.core[np.argmin(norm(x.v[:, None, :2] - stem.core), axis=1)]
            gap = (x[:2] - corner).norm() - stem.radius
            rise = x[2] - self.start[s.piece, k, 2:]
            bounds = gap.norm(), rise.norm(), x[2] - stem.upper, -x[2] + stem.lower
            errors += [y.where(bent) for y in bounds]
            u = s.rotated(self.b, edge)[:2]
            valid = u.norm().high > WRAP_TOL
            n = u.unit()
            for corner in stem.core:
                to = -x[:2] + corner
                errors.append((n[0] * to[1] - n[1] * to[0] + stem.radius).where(valid))
        return maximum(*errors)


def steady(p: Plan, b: int) -> Iterator[Row]:
    """Prove that cables around a carried polygon grow longer as it turns, seen from above.

    Tension is constant, drones are at rest, and the body and clasps yield: all coordinates but the
    body's turn, first, are eliminated from the second derivatives of the energy.
    """
    body = p.bodies[b]
    stem = p.bodies[b].stem
    size = 3 + 2 * p.n

    def stiffness(s: Spans, _: Index) -> Line:
        """Return the stiffness of yaw; the coordinates are turn, body (1, 2) and clasps."""
        H = [[s.zero] * size for _ in range(size)]
        centre = s.world(b, body.centre)[:2]

        def lengthen(x: Line, T: Line, left: dict[int, Line]) -> None:
            """Add ``T m m' / |x|`` of a part of which coordinates move an end to the left."""
            ratio = T * x.norm().inverse()
            for i, j in product(left, left):
                H[i][j] = H[i][j] + left[i] * left[j] * ratio

        for k, end in product(range(p.n), (0, 1)):
            T = p.tensions.on(s, k)
            vertex = int((p.begin, p.end)[end][k])
            clasp = 3 + 2 * (vertex - p.N)
            leg = s.leg(2 * k + end)[:2]
            part = (s.edge(k)[1] if end else -s.edge(k)[0])[:2]
            for x in (leg, part):
                u = x.unit()
                left = {clasp: -u[1], clasp + 1: u[0]}
                if x is part:
                    arm = u.dot(s.point(vertex)[:2] - centre)
                    left = {0: -arm, 1: u[1], 2: -u[0], **left}
                    H[0][0] = H[0][0] - T * arm
                    for i in (1, 2, clasp, clasp + 1):
                        H[0][i], H[i][0] = (H[0][i] + T * left[i],) * 2
                lengthen(x, T, left)
        for last in reversed(range(1, size)):
            inverse = H[last][last].inverse()
            for i, j in product(range(last), range(last)):
                H[i][j] = H[i][j] - H[i][last] * H[last][j] * inverse
        return H[0][0]

    polygons = loaded_grip(p, b) & (not stem.round)
    yield prove("yaw N·m min", 0.0, Spans.of(p, polygons, [0], [body.name]), stiffness)
