"""Whether a plan hangs together: jumps of curves, and states of phases and objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from .arithmetic import POS_TOL, Array, Items, Mask, norm, runs_of, varies
from .catenary import lowest_height
from .drones import thrust
from .objects import support_below
from .parts import taut_length
from .plan import CLASPING, CONTACT_TOL, GROUNDED, LOOSE, TIGHTENED, Plan
from .shapes import to_frame
from .spans import RESOLUTION, Fault, Row, Spans, Worst, fault_row, worst_row

JUMP_UNITS = "m", "m/s", "m/s²"  # of jumps of curves, and of their derivatives
StateFault = tuple[bool, str]  # whether it applies, text


def jumps(p: Plan, rests: Sequence[int] = ()) -> Iterator[Row]:
    """Check jumps of curves at joints of pieces, as sums over time, and jumps of thrusts and pulls.

    They ``rest`` at the start (0) or the end (-1) of the plan.
    """
    jumps_by_unit = [*curve_jumps(p), *rates_at_rest(p, rests)]
    worst = max(jumps_by_unit, key=lambda each: each[0][0], default=None)
    values, unit = ([], "m") if worst is None else ([worst[0]], worst[1])
    yield worst_row("continuity", unit, 1e-6, values)
    if p.n:
        yield worst_row("tension", "N", 1e-4, [*force_jumps(p), *range_errors(p)])


def curve_jumps(p: Plan) -> Iterator[tuple[Worst, str]]:
    """Yield the sums of jumps of curves and of two derivatives, with their units.

    Those of vertices are between pieces on which cables pull drones, those of legs between taut
    ones.
    """
    bodies = [body.name for body in p.bodies]
    both_taut, both_pulling = ((on[1:] & on[:-1])[:, None] for on in (p.formed, p.pulling))
    for k, unit in enumerate(JUMP_UNITS):
        points = p.points.c[k]
        for jumps, names in (
            (jumps_of(points[:, : p.N]), p.names),
            (jumps_of(p.poses.c[k]), bodies),
            (jumps_of(points[:, p.V]) * both_pulling, p.labels[p.V]),
            (jumps_of(p.legs.c[k]) * both_taut, p.names),
        ):
            yield from ((worst, unit) for worst in total_jump(jumps, p, names))


def rates_at_rest(p: Plan, rests: Sequence[int]) -> Iterator[tuple[Worst, str]]:
    """Yield speeds and accelerations at ends at which drones and objects rest, with units."""
    bodies = [body.name for body in p.bodies]
    for k, end in product((1, 2), rests):
        time = float(p.breaks[end])
        for curve, names in ((p.points.c[k][:, : p.N], p.names), (p.poses.c[k], bodies)):
            for rate, name in zip(norm(curve[end, ..., end]).tolist(), names, strict=True):
                yield (rate, time, name), JUMP_UNITS[k]


def force_jumps(p: Plan) -> Iterator[Worst]:
    """Yield the largest jumps of thrusts, and of tensions of edges and legs."""
    drones = Spans.of(p, p.all_pieces, range(p.N))
    with np.errstate(all="ignore"):
        ends = [thrust(drones.subspan(end), drones.item[:, 0]).v for end in (-1.0, 1.0)]
    thrusts = np.stack(ends, axis=-1).reshape(-1, p.N, 3, 2)
    pulling = p.pulling[:, None, None, None]
    yield from largest_jump(jumps_of(thrusts), p, p.names)
    yield from largest_jump(jumps_of(p.tensions.c[0] * pulling), p, p.cables)
    yield from largest_jump(jumps_of(p.pulls.c[0] * pulling), p, p.names)


def range_errors(p: Plan) -> Iterator[Worst]:
    """Yield differences of tensions from the team's at both ends of ranges.

    Where an object is held on both sides, tensions may differ.
    """
    held = np.pad(np.any(p.held, axis=0), 1, "edge")
    ranged = np.append(p.range_phase, -1)
    for q, end in product(np.flatnonzero(p.formed & (p.range_phase >= 0)), (0, -1)):
        beyond = q - 1 - 2 * end  # the piece before or after; without a range beyond the plan
        if ranged[beyond] != ranged[q] and not (held[q + 1] and held[beyond + 1]):
            error = np.max(np.abs(p.tensions.c[0][q, :, :, end] - p.stated_tension))
            yield float(error), float(p.breaks[q - end]), "range"


def jumps_of(c: Array) -> Array:
    """Return the jumps (m - 1, items) of curves (m, items, d, N + 1) at joints of pieces."""
    return norm(c[1:, ..., 0] - c[:-1, ..., -1])


def largest_jump(x: Array, p: Plan, names: Sequence[str]) -> Iterator[Worst]:
    """Yield the largest of jumps (m - 1, items), if there are any."""
    if x.size:
        yield worst_item(np.max(x, axis=0), x, p, names)


def total_jump(x: Array, p: Plan, names: Sequence[str]) -> Iterator[Worst]:
    """Yield the largest sum of jumps (m - 1, items) above rounding errors, if there are any."""
    if x.size:
        sums = np.sum(np.where(x > 1e-9, x, 0.0), axis=0)
        yield worst_item(np.maximum(sums, np.max(x, axis=0)), x, p, names)


def worst_item(values: Array, x: Array, p: Plan, names: Sequence[str]) -> Worst:
    """Return the largest of values (items,), at the time of the item's largest jump."""
    item = int(np.argmax(values))
    joint = int(np.argmax(x[:, item]))
    return float(values[item]), float(p.breaks[joint + 1]), names[item]


def consistency(p: Plan) -> Iterator[Row]:
    """Check phases and objects for contradictions, and the duration."""
    yield fault_row("consistency", (*phase_faults(p), *clasp_faults(p), *object_faults(p)))
    if p.limits["duration"] is not None:
        end = float(p.breaks[-1])
        yield worst_row("duration", "s", p.limits["duration"], [(end, end, "")])


def phase_faults(p: Plan) -> Iterator[Fault]:
    """Yield contradictions between curves and the states of cables in phases."""
    for i, phase in enumerate(p.phases):
        on = p.phase == i
        if not np.any(on):  # shorter than what files resolve
            continue
        faults = [*unformed_faults(p, on), *FAULTS_OF_STATES.get(phase["state"], no_faults)(p, on)]
        if phase["state"] == LOOSE:
            follows = i > 0 and p.phases[i - 1]["state"] != LOOSE
            faults.append((follows, "cables are loose without a loss at the start"))
        yield from ((phase["start"], applies, text) for applies, text in faults)


def no_faults(_p: Plan, _on: Mask) -> Iterator[StateFault]:
    """Yield nothing."""
    yield from ()


def unformed_faults(p: Plan, on: Mask) -> Iterator[StateFault]:
    """Yield tensions of cables that do not pull, and legs of those that form no hitch."""
    pulls = any(np.any(curve.c[0][on & ~p.pulling]) for curve in (p.tensions, p.pulls))
    has_legs = bool(np.any(p.legs.c[0][on & p.free]))
    yield pulls or has_legs, "tensions or legs without a hitch"


def grounded_faults(p: Plan, on: Mask) -> Iterator[StateFault]:
    """Yield cables that do not lie on the ground."""
    if not p.n:
        return
    spans, cables = of_cables(p, on)
    with np.errstate(all="ignore"):
        heights = [np.min(lowest_height(spans.subspan(x), cables).v) for x in (-1.0, 0.0, 1.0)]
    is_high = min(heights) - p.floor > p.settings["separation"]["cable"] + RESOLUTION
    moves = varies(p.points.c[0][on, : p.N, :2])
    yield is_high or moves, "cables do not lie on the ground as stated"


def clasping_faults(p: Plan, on: Mask) -> Iterator[StateFault]:
    """Yield pairs whose middle moves."""
    drones = p.points.c[0][on, : p.N]
    middles = 0.5 * (drones[:, 2 * p.clasps] + drones[:, 2 * p.behind + 1])
    yield varies(middles, RESOLUTION), "drones do not turn about each other"


def tightened_faults(p: Plan, on: Mask) -> Iterator[StateFault]:
    """Yield cables that are slack by name, and have their full length for more than half a phase.

    Cables of more tension count more.
    """
    spans, cables = of_cables(p, on)
    leaving, arriving = spans.edge(cables)
    chords = spans.leg(2 * cables), spans.leg(2 * cables + 1), leaving + arriving
    ratio = spans.zero + p.weight / p.stated_tension[cables] if p.weight else None
    total = sum((taut_length(x, ratio) for x in chords), spans.zero).v.reshape(-1, p.n)
    is_full = (total - (1.0 - 1e-4) * p.length[:, 0]) @ p.stated_tension[:, 0] > 0.0
    full_time, time = np.sum(p.h[on] * is_full), np.sum(p.h[on])
    yield bool(full_time > 0.5 * time), "cables stated as slack have their full length"


def clasp_faults(p: Plan) -> Iterator[Fault]:
    """Yield clasps that leave the straight lines on which cables are tightened, in each run."""
    for pieces in runs_of(p.state == TIGHTENED):
        places = np.moveaxis(p.points.c[0][pieces][:, p.V], -1, 1)  # (pieces, N + 1, P, 3)
        start, along = places[0, 0], places[-1, -1] - places[0, 0]
        share = np.sum((places - start) * along, -1) / np.maximum(norm(along) ** 2, 1e-12)
        off = norm(places - start - np.clip(share, 0.0, 1.0)[..., None] * along)
        time = float(p.breaks[pieces[0]])
        yield time, bool(np.max(off) > RESOLUTION), "clasps wander while cables are tightened"


def of_cables(p: Plan, on: Mask) -> tuple[Spans, Items]:
    """Return spans of all cables without a hitch on pieces, and the cables."""
    free = on & p.free
    return Spans.of(p, free, range(p.n)), np.tile(np.arange(p.n), int(np.sum(free)))


FAULTS_OF_STATES: dict[str, Callable[[Plan, Mask], Iterator[StateFault]]] = {
    GROUNDED: grounded_faults,
    CLASPING: clasping_faults,
    TIGHTENED: tightened_faults,
}
"""Contradictions of curves and a state of cables, on pieces in that state."""


def object_faults(p: Plan) -> Iterator[Fault]:
    """Yield objects without support, that move unheld, or with inconsistent load shares."""
    c = p.poses.c[0]
    for b, body in enumerate(p.bodies):
        moving, busy, lifted = p.moving[b], p.active[b], p.lifted[b]
        spans = Spans.of(p, p.all_pieces, [b])
        middles = (-1.0, -0.5, 0.0, 0.5, 1.0)
        headings = np.array([norm(p.poses.at(spans.subspan(x), b)[:, 3:]) for x in middles])
        supports = np.array([support_below(p, b, pose)[0] for pose in c[..., 0]])
        bases = c[:, b, 2, 0] + body.stem.lower
        falls = (np.abs(bases - supports) > POS_TOL) & ~lifted & ~moving
        share = p.load_share.c[0][:, b, 0]
        for wrong, words in (
            (np.max(np.abs(headings - 1.0), axis=0) > POS_TOL, "has an invalid heading"),
            (busy & ~(p.held[b] & p.formed), "moves or has a load share without a hold"),
            (moving & ~lifted, "moves without a load fraction of 1"),
            (np.any((share < 0.0) | (share > 1.0), axis=-1), "has a load share outside 0 to 1"),
            (busy & body.fixed, "is fixed but moves"),
            (falls & (not body.fixed), "has no support"),
            (p.grip[b] & (not p.n or not p.has_contacts), "is gripped by straight edges"),
            (p.rest[b] & ~clasps_hold(p, b), "is not inside the clasps below its rim"),
        ):
            yield float(p.breaks[np.argmax(wrong)]), bool(np.any(wrong)), f"{body.name} {words}"


def clasps_hold(p: Plan, b: int) -> Mask:
    """Return the pieces (m,) at whose start all clasps are around a body and below its rim."""
    body = p.bodies[b]
    if body.rim is None or not p.closed:
        return ~p.all_pieces
    clasps = to_frame(p.poses.c[0][:, b, None, :, 0], p.points.c[0][:, p.V, :, 0])
    edges = (np.roll(clasps, -1, axis=1) - clasps)[..., :2]
    to_centre = body.centre[:2] - clasps[..., :2]
    is_right = edges[..., 1] * to_centre[..., 0] - edges[..., 0] * to_centre[..., 1] > 0.0
    is_below = clasps[..., 2] <= body.height + CONTACT_TOL
    return np.asarray(np.all(is_right & is_below, axis=1))
