"""All rows of a file, and their report on the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import combinations, product
from pathlib import Path

import numpy as np

from .arithmetic import POS_TOL, TOLERANCE, norm
from .cables import taut_cables
from .consistency import consistency, jumps
from .drones import drones
from .links import interlacing
from .losses import Stated, losses, read_stated
from .objects import clear_held, clear_objects, gripped, resting, steady
from .plan import TAUT_TOL, Plan
from .reading import UnreadableError, read
from .request import requested
from .slides import friction_shifts, rest_shifts
from .spans import MIN_TENSION, NOTHING, SAMPLED, Row, Spans, prove, worst_row
from .statics import vertex_errors
from .teams import Pair, arc_distances, between_plans, object_distances
from .tying import free_cables

GROSS = 10.0  # ratio to a limit from which on curves are no plan at all
JUMP = 0.01  # [m] largest jump of curves that are a plan
ROUNDING_ERROR = 1e-9  # largest value that is written as 0
STATED = "not recomputed"  # rules of the user, whose formulas are not in the file
PASSING = {"proven", SAMPLED, NOTHING, STATED}  # verdicts that do not fail
ORDER = "violated", "not proven", SAMPLED, "proven", NOTHING  # of verdicts, the worst first
# Rows that tracking errors of drones change
DISTANCES = "separation", "cable_clearance", "crossing", "object_clearance", "keep_out", "downwash"
ERRING = frozenset({*DISTANCES, "arena", "legs", "span"})


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
    is_loose = (largest < MIN_TENSION) & (lacking > TAUT_TOL) & p.formed[:, None] & ~p.ramp
    for q, k in np.argwhere(is_loose)[:1]:
        missing = [(float(lacking[q, k]), float(p.breaks[q]), p.cables[k])]
        yield worst_row("tension", "N", TAUT_TOL, missing)


def plan_rows(p: Plan) -> Iterator[Row]:
    """Yield the rows of all checks, several for some limits."""
    yield from (*consistency(p), *distances(p))
    for check_of, b in product((resting, gripped, steady, clear_held), range(len(p.bodies))):
        yield from check_of(p, b)
    yield from (*jumps(p), *interlacing(p), *vertex_errors(p), *friction_shifts(p), *rest_shifts(p))


def distances(p: Plan) -> Iterator[Row]:
    """Yield the rows of drones, cables and objects, with all distances."""
    yield from drones(p)
    if np.any(p.formed):
        yield from taut_cables(p)
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
    path = path / "plan.npz" if path.is_dir() else path
    own, others = read(path)
    stated = None
    if any(p.limits.get("survive") for p in own):
        try:
            stated = read_stated(path, own)
        except Exception as error:  # malformed files raise many kinds
            words = " ".join(f"certificate.json: {type(error).__name__}: {error}".split())
            raise UnreadableError(words[:300]) from error
    yield from proofs(own, others, stated)
    yield from stated_rules(own[0])


def proofs(
    own: Sequence[Plan], others: Sequence[Plan], stated: Stated | None = None
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
        yield row if erring is None else with_errors(row, erring)


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
    """Yield the worst row of every quantity; limits of teams and drones may differ.

    There is none for quantities of bodies and states that the plan does not have.
    """
    evaluated = {row.name for row in rows if row.samples}
    empty = [row for row in rows if row.verdict == NOTHING and row.name not in evaluated]
    rows = [*(row for row in rows if row.samples), *empty]
    for quantity in dict.fromkeys((row.name, row.unit) for row in rows):
        same = [row for row in rows if (row.name, row.unit) == quantity]
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
    worst = "–" if np.isnan(row.worst) else _significant(row.worst)
    erring = "" if np.isnan(row.with_errors) else _significant(row.with_errors)
    limit = f"{'≥' if row.sense == 'min' else '≤'} {row.limit:.4g}"
    when = "" if np.isnan(row.time) else f"{row.time:.3f} s"
    unit = "number" if row.unit == "1" else row.unit
    return row.name, worst, erring, limit, unit, row.where, when, row.verdict


def _significant(value: float) -> str:
    """Return four digits of a number; rounding errors are 0."""
    return f"{value:.4g}" if abs(value) > ROUNDING_ERROR else "0"


def verdict(rows: Sequence[Row]) -> str:
    """Return the verdict of all rows in words."""
    bad = dict.fromkeys(row.name for row in rows if row.verdict not in PASSING)
    stated = ", ".join(row.name for row in rows if row.verdict == STATED)
    rest = f"; not recomputed: {stated}" if stated else ""
    if sampled := ", ".join(row.name for row in rows if row.verdict == SAMPLED):
        rest += f"; only at samples: {sampled}"
    if nothing := ", ".join(row.name for row in rows if row.verdict == NOTHING):
        rest += f"; {NOTHING}: {nothing}"
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
