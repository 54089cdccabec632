"""All rows of a file, and their report on the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from .arithmetic import POS_TOL, TOLERANCE, Array, norm, varies
from .cables import OPEN_ROLL, taut_cables
from .catenary import lowest_height
from .drones import drones, thrust
from .links import interlacing, roll_changes
from .losses import losses, read_stated
from .objects import clear_held, clear_objects, gripped, hinged, resting, steady, support_below
from .plan import (
    CONTACT_TOL,
    DRAWN,
    LAID,
    LOOSE,
    ROLLING,
    TAUT_TOL,
    Plan,
)
from .reading import UnreadableError, read
from .request import requested
from .shapes import to_frame
from .spans import (
    MIN_TENSION,
    RESOLUTION,
    SAMPLED,
    Fault,
    Row,
    Spans,
    Worst,
    fault_row,
    prove,
    worst_row,
)
from .statics import friction_shifts, vertex_errors
from .teams import Pair, arc_distances, between_plans, object_distances
from .tying import bent_cables, free_cables

GROSS = 10.0  # ratio to a limit from which on curves are no plan at all
JUMP = 0.01  # [m] largest jump of curves that are a plan
STATED = "not recomputed"  # rules of the user, whose formulas are not in the file
NO_LIMIT = "no limit"  # height above z = 0, which is only the ground if there is an arena
PASSING = {"proven", SAMPLED, NO_LIMIT, STATED}  # verdicts that do not fail
ORDER = "violated", "not proven", SAMPLED, "proven"  # of verdicts, the worst first
# Rows that tracking errors of drones change
DISTANCES = "separation", "cable_clearance", "crossing", "object_clearance", "keep_out", "downwash"
ERRING = frozenset({*DISTANCES, "arena", "ground", "legs", "span"})


def jumps(p: Plan, rests: Sequence[int] = ()) -> Iterator[Row]:
    """Check jumps of curves at joints of pieces, as sums over time, and jumps of thrusts and pulls.

    They ``rest`` at the start (0) or the end (-1) of the plan.
    """
    yield worst_row("continuity", "m", 1e-6, [*curve_jumps(p), *rates_at_rest(p, rests)])
    if p.n:
        yield worst_row("tension", "N", 1e-4, [*force_jumps(p), *range_errors(p)])


def curve_jumps(p: Plan) -> Iterator[Worst]:
    """Yield the sums of jumps of curves and of two derivatives; of cables between taut pieces."""
    bodies = [body.name for body in p.bodies]
    both_taut = (p.taut[1:] & p.taut[:-1])[:, None]
    for k in range(3):
        points = p.points.c[k]
        yield from total_jump(jumps_of(points[:, : p.N]), p, p.names)
        yield from total_jump(jumps_of(p.poses.c[k]), p, bodies)
        yield from total_jump(jumps_of(points[:, p.V]) * both_taut, p, p.labels[p.V])
        if np.any(p.bent):  # inner ends of legs
            yield from total_jump(jumps_of(points[:, p.anchor]) * both_taut, p, p.names)
        yield from total_jump(jumps_of(p.legs.c[k]) * both_taut, p, p.names)


def rates_at_rest(p: Plan, rests: Sequence[int]) -> Iterator[Worst]:
    """Yield speeds and accelerations of drones and objects at ends at which they rest."""
    bodies = [body.name for body in p.bodies]
    for k, end in product((1, 2), rests):
        time = float(p.breaks[end])
        for curve, names in ((p.points.c[k][:, : p.N], p.names), (p.poses.c[k], bodies)):
            for rate, name in zip(norm(curve[end, ..., end]).tolist(), names, strict=True):
                yield rate, time, name


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
    yield fault_row("consistency", (*phase_faults(p), *object_faults(p)))
    if p.limits["duration"] is not None:
        end = float(p.breaks[-1])
        yield worst_row("duration", "s", p.limits["duration"], [(end, end, "")])


def phase_faults(p: Plan) -> Iterator[Fault]:
    """Yield contradictions between curves and the states of cables in phases."""
    c = p.points.c[0][:, : p.N]
    for i, phase in enumerate(p.phases):
        at = phase["start"]
        state = phase["state"]
        on = p.phase == i
        if not np.any(on):  # shorter than what files resolve
            continue
        s = Spans.of(p, on & p.free, range(p.n))
        k = np.tile(np.arange(p.n), np.sum(on & p.free))
        pulls = any(np.any(x.c[0][on & ~p.pulling]) for x in (p.tensions, p.pulls))
        stray = pulls or bool(np.any(p.legs.c[0][on & p.free]))
        yield at, stray, "tensions or legs without a hitch"
        if state == LAID:
            yield at, varies((c[:, 1::2] - c[:, 0::2])[on]), "cables turn while they are laid"
        if state == ROLLING:
            legs = p.legs.c[0][on]  # change as they sag, or as weight passes
            lowest = np.min(p.min_tension[on], axis=0)
            sag = (p.weight / lowest) ** 2 / 24.0 * np.max(legs, (0, -1)).reshape(p.n, 2) ** 3
            drift = (sag + 1e-4).reshape(legs.shape[1:-1])
            rolls = varies(p.points.c[0][on][:, p.V]) or varies(legs, drift)
            yield at, rolls, "vertices or legs move while pairs roll"
            T, pulled = p.tensions.c[0][on], p.pulls.c[0][on]
            other = np.max(np.abs(pulled - np.repeat(T, 2, 1))) > 1e-4
            busy = np.any(p.load) or np.any((p.rest | p.active)[:, on]) or other
            yield at, bool(busy), "pairs with loads or unequal pulls roll"
            start, change, _ = roll_changes(p, np.flatnonzero(on))
            shut = np.abs([start, start + change]) < OPEN_ROLL
            yield at, bool(np.all(shut)), "no pair rolls or lies across"
        if state == DRAWN:
            yield at, varies(c[on][:, :, 2]), "drones change their heights as cables are drawn taut"
        if p.two and np.any(on & p.formed):
            yield at, phase["hold"] is None, "two cables are tied around nothing"
        if p.n and state == "on the ground":
            with np.errstate(all="ignore"):
                depth = [np.min(lowest_height(s.subspan(x), k).v) for x in (-1.0, 0.0, 1.0)]
            high = min(depth) - p.floor > p.settings["separation"]["cable"] + RESOLUTION
            high |= varies(c[on][:, :, :2])
            yield at, high, "cables do not lie on the ground as stated"
        if state == "clasping":
            middle = 0.5 * (c[on][:, 2 * p.clasps] + c[on][:, 2 * p.behind + 1])
            yield at, varies(middle, RESOLUTION), "drones do not turn about each other"
        if state == LOOSE:
            follows = i > 0 and p.phases[i - 1]["state"] != LOOSE
            yield at, follows, "cables are loose without a loss at the start"
        if state == "being tightened":
            over = s.route_length(k).v.reshape(-1, p.n) - (1.0 - 1e-4) * p.length[:, 0]
            full = np.sum(p.h[on] * (over @ p.stated_tension[:, 0] > 0.0)) > 0.5 * np.sum(p.h[on])
            yield at, full, "cables stated as slack have their full length"


def object_faults(p: Plan) -> Iterator[Fault]:
    """Yield objects without support, that move unheld, or with inconsistent load shares."""
    c = p.poses.c[0]
    for b, body in enumerate(p.bodies):
        moving, busy, lifted = p.moving[b], p.active[b], p.lifted[b]
        s = Spans.of(p, p.all_pieces, [b])
        head = [norm(p.poses.at(s.subspan(x), b)[:, 3:]) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)]
        under = np.array([support_below(p, b, x)[0] for x in c[..., 0]])
        falls = (np.abs(c[:, b, 2, 0] + body.stem.lower - under) > POS_TOL) & ~lifted & ~moving
        loose = p.rest[b] & (body.rim is None or not p.closed)
        share = p.load_share.c[0][:, b, 0]
        if p.n and not np.all(loose):
            seen = to_frame(c[:, b, None, :, 0], p.points.c[0][:, p.V, :, 0])
            side = (np.roll(seen, -1, 1) - seen)[..., :2]
            to = body.centre[:2] - seen[..., :2]
            right = side[..., 1] * to[..., 0] - side[..., 0] * to[..., 1] > 0.0
            below = seen[..., 2] <= body.height + CONTACT_TOL
            loose |= p.rest[b] & ~np.all(right & below, axis=1)
        for wrong, words in (
            (np.max(np.abs(np.array(head) - 1.0), axis=0) > POS_TOL, "has an invalid heading"),
            (busy & ~(p.held[b] & p.formed), "moves or has a load share without a hold"),
            (moving & ~lifted, "moves without a load fraction of 1"),
            (np.any((share < 0.0) | (share > 1.0), axis=-1), "has a load share outside 0 to 1"),
            (busy & body.fixed, "is fixed but moves"),
            (falls & (not body.fixed), "has no support"),
            (p.grip[b] & (not p.n or not p.has_contacts), "is gripped by straight edges"),
            (loose, "is not inside the clasps below its rim"),
        ):
            yield float(p.breaks[np.argmax(wrong)]), bool(np.any(wrong)), f"{body.name} {words}"


def hopeless(p: Plan) -> Iterator[Row]:
    """Yield violated rows of curves that are so far from a plan that other proofs would not end.

    Drones are GROSS times too fast at the middle of a piece, jump, or hold cables without tension.
    """
    s = Spans.of(p, p.all_pieces, range(p.N), p.names)
    for k, header in enumerate(("speed m/s max", "acceleration m/s² max", "jerk m/s³ max"), 1):
        row = prove(header, p.limits[header.split()[0]], s, lambda s, i, k=k: s.point(i, k).norm())
        if row.worst > GROSS * row.limit:
            yield row
    x = p.points.c[0][:, : p.N]
    steps = np.max(norm(x[1:, ..., 0] - x[:-1, ..., -1]), axis=1, initial=0.0)
    if np.any(steps > JUMP):
        q = int(np.argmax(steps))
        yield worst_row("continuity", "m", 1e-6, [(float(steps[q]), float(p.breaks[q + 1]), "")])
    if not p.n:
        return
    largest = np.max(p.tensions.c[0], axis=(2, 3), initial=0.0)
    lacking = np.min(p.tension_range, axis=2) - largest
    is_loose = (largest < MIN_TENSION) & (lacking > TAUT_TOL) & p.taut[:, None] & ~p.ramp
    for q, k in np.argwhere(is_loose)[:1]:
        missing = [(float(lacking[q, k]), float(p.breaks[q]), p.cables[k])]
        yield worst_row("tension", "N", TAUT_TOL, missing)


def plan_rows(p: Plan) -> Iterator[Row]:
    """Yield the rows of all checks, several for some limits."""
    yield from (*consistency(p), *distances(p))
    for check_of, b in product(
        (resting, gripped, steady, hinged, clear_held), range(len(p.bodies))
    ):
        yield from check_of(p, b)
    yield from (*jumps(p), *interlacing(p), *vertex_errors(p), *friction_shifts(p))


def distances(p: Plan) -> Iterator[Row]:
    """Yield the rows of drones, cables and objects, with all distances."""
    yield from drones(p)
    if np.any(p.taut):
        yield from taut_cables(p)
    if np.any(p.bent):
        yield from bent_cables(p)
    if p.n:
        yield from free_cables(p)
    for b in range(len(p.bodies)):
        yield from clear_objects(p, b)


def stated_rules(p: Plan) -> Iterator[Row]:
    """Yield the custom rules that a file states, unproven; stated values may break their limits."""
    for rule in p.stated:
        worst = np.nan if rule["worst"] is None else float(rule["worst"])
        limit = float(rule["limit"])
        sense = rule["sense"]
        excess = (worst - limit) * (1.0 if sense == "max" else -1.0)
        broken = excess > TOLERANCE * max(abs(limit), 1.0)
        found = "violated" if broken else STATED
        yield Row(rule["name"], rule["unit"], found, worst, limit, sense, np.nan, "", samples=0)


def verify(path: str | Path) -> Iterator[Row]:
    """Yield a row for every limit of a plan; UnreadableError if the file is not a plan."""
    path = Path(path)
    own, others = read(path / "plan.npz" if path.is_dir() else path)
    stated = None
    if any(p.limits.get("survive") for p in own):
        try:
            stated = read_stated(path if path.is_dir() else path.parent)
        except ValueError as error:
            raise UnreadableError(str(error)) from error
    yield from proofs(own, others, stated)
    yield from stated_rules(own[0])


def proofs(
    own: Sequence[Plan], others: Sequence[Plan], stated: dict[str, Any] | None = None
) -> Iterator[Row]:
    """Yield a row for every limit of the plans of teams, next to other plans.

    ``stated`` is their certificate, which tells what remains after losses.
    """
    if rows := [row for p in own for row in hopeless(p)]:
        yield from {row.name: row for row in rows}.values()
        return
    exact = [p.without_errors() for p in own]
    rows = [row for p in exact for row in (*requested(p), *plan_rows(p))]
    if len(own) + len(others) > 1:
        every = [*own, *others]
        first = min(p.breaks[0] for p in every)  # teams may begin a flight in motion
        begins = [p for p in own if p.breaks[0] <= first + POS_TOL]
        for p in every:
            ends = (-1,) if p in begins else (0, -1)
            rows += (row for row in jumps(p, ends) if row.name == "continuity")
    rows += [row for p in own for row in losses(p, stated)]
    rows += between_teams(exact, others, (0.0, 0.0))
    tube = max(p.tube[0] for p in own), max(p.tube[1] for p in own)
    of_errors = list[Row]()
    if tube[0]:
        of_errors = [row for p in own for row in distances(p.proving(ERRING))]
        of_errors += between_teams(own, others, tube)
    errors = {row.name: row for row in worst_rows(of_errors)}
    for row in worst_rows(rows):
        erring = errors.get(row.name)
        worst = row if erring is None else with_errors(row, erring)
        passes = worst.name != "ground" or worst.verdict == "proven"
        yield worst if passes else worst._replace(verdict=NO_LIMIT)


def between_teams(
    own: Sequence[Plan], others: Sequence[Plan], tube: tuple[float, float]
) -> Iterator[Row]:
    """Yield the rows of distances between teams, and to other plans, with errors of drones [m]."""
    keys = own[0].settings["separation"]
    wide = {key: max(p.settings["separation"][key] for p in own) for key in keys}
    for p, q in combinations([*own, *others], 2):
        if p in own:
            one, two = Pair(p, q, wide, tube), Pair(q, p, wide, tube)
            yield from between_plans(one)
            for pair in (one, two):
                yield from (*object_distances(pair), *arc_distances(pair))


def worst_rows(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the worst row of every quantity; limits of teams and drones may differ."""
    proven = [row for row in rows if row.samples]
    for quantity in dict.fromkeys((row.name, row.unit) for row in proven):
        same = [row for row in proven if (row.name, row.unit) == quantity]
        worst = min(same, key=lambda row: (ORDER.index(row.verdict), -row.excess))
        yield worst._replace(samples=sum(row.samples for row in same))


def with_errors(row: Row, erring: Row) -> Row:
    """Return a row with the value that tracking errors leave, and the worse verdict of both.

    Errors widen some limits, and shorten other distances: the value is as far from the row's limit.
    """
    verdict = min(row.verdict, erring.verdict, key=ORDER.index)
    value = row.limit + erring.worst - erring.limit
    return row._replace(verdict=verdict, with_errors=value, samples=row.samples + erring.samples)


def cells(row: Row) -> tuple[str, ...]:
    """Return cells of a row: check, worst, with errors, limit, unit, place, time and verdict."""
    worst = "–" if np.isnan(row.worst) else f"{row.worst:.5g}"
    erring = "" if np.isnan(row.with_errors) else f"{row.with_errors:.5g}"
    limit = f"{'≥' if row.sense == 'min' else '≤'} {row.limit:.4g}"
    when = "" if np.isnan(row.time) else f"{row.time:.3f} s"
    unit = "number" if row.unit == "1" else row.unit
    return row.name, worst, erring, limit, unit, row.where, when, row.verdict


def verdict(rows: Sequence[Row]) -> str:
    """Return the verdict of all rows in words."""
    bad = dict.fromkeys(row.name for row in rows if row.verdict not in PASSING)
    stated = ", ".join(row.name for row in rows if row.verdict == STATED)
    rest = f"; not recomputed: {stated}" if stated else ""
    if any(row.verdict == NO_LIMIT for row in rows):
        rest += "; not proven: heights above z = 0, which are limited only by an arena"
    if sampled := ", ".join(row.name for row in rows if row.verdict == SAMPLED):
        rest += f"; only at samples: {sampled}"
    if bad:
        return f"not proven: {', '.join(bad)}{rest}"
    return f"proven: every limit holds at all times{rest}"


def main(arguments: Sequence[str]) -> int:
    """Print the rows of the plan in a directory; return 0 proven, 3 not proven, 2 unreadable."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python -m hitchopt.verify DIR\n")
        return 2
    rows = []
    try:
        for row in verify(arguments[0]):
            rows.append(row)
            sys.stdout.write("{:16} {:>10} {:>11} {:8} {:5} {:16} {:>9} {}\n".format(*cells(row)))
    except UnreadableError as error:
        sys.stderr.write(f"{arguments[0]}: not a plan, or a damaged one: {error}\n")
        return 2
    sys.stdout.write(f"{verdict(rows)}\n")
    return 0 if all(row.verdict in PASSING for row in rows) else 3
