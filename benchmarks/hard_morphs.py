"""How often the optimiser finds a way where the straight one may be shut, and how good it is.

Usage: python -m benchmarks.hard_morphs [--seeds N] [--restarts M] [--robots N …] [--no-named]

Random hard morphs (``problems.random_morph``, seeded): turned by any angle, scaled,
shifted, reshaped. Every success is a certificate. Of those not solved, and of the named hard ones,
M random restarts (turned either way, bent, swollen or shrunk on the way) tell what might be found.
Writes ``hard_morphs.csv``, a line for every morph as it is done, and ``hard_morphs.md``. A morph
that is in the former already is not done again.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import date
from itertools import chain
from pathlib import Path

import numpy as np

from benchmarks.environment import busy, environment
from benchmarks.hard_cases import Case, named_cases, random_case, random_name
from benchmarks.hard_restarts import CAP, restarts
from hitchopt.planners.optimise.candidates import ROUNDS, OptimisedMorph

LIMITATIONS = (
    "one machine, one run, other jobs beside it; processor time, not the wall's; "
    "every success is a certificate; ends that break a limit at rest are counted apart; random "
    "morphs are restarted only where the default search finds nothing; 'believed infeasible' "
    f"means that no restart found a way, no proof; a restart is stopped after {CAP:.0f} s of "
    "processor time, as soon as its current solve returns, and then counts as not found; "
    "restarts take the optimiser's own steps, from other guesses, so they are no rival of it"
)


@dataclass(frozen=True)
class Outcome:
    """What became of one morph.

    Attributes
    ----------
    morph: its name.
    robots: n; 0 for a named one.
    status: solved; ends: one of them breaks a limit at rest; failed: but a restart solves it;
        believed infeasible.
    duration: of the certified flight [s], infinity if none.
    search: processor time of the search [s].
    guess: from which the way came.
    restarts, found, capped: how many, how many found a way, how many the cap stopped.
    best: of the restarts' certified durations [s], infinity if none.
    """

    morph: str
    robots: int
    status: str
    duration: float = np.inf
    search: float = 0.0
    guess: str = ""
    restarts: int = 0
    found: int = 0
    capped: int = 0
    best: float = np.inf


def outcome(case: Case, robots: int, count: int) -> Outcome:
    """Return what becomes of a morph; restarts for named ones and where none is found."""
    began = time.process_time()
    found = OptimisedMorph(case.start, case.end, case.requirements, case.judge).solve()
    seconds = time.process_time() - began
    if found and robots:
        first = found[0]
        return Outcome(case.name, robots, "solved", first.flight.duration, seconds, first.name)
    again = restarts(case, count)
    tried = (again.count, again.found, again.capped, again.best)
    if found:
        first = found[0]
        duration = first.flight.duration
        return Outcome(case.name, robots, "solved", duration, seconds, first.name, *tried)
    status = "failed" if again.found else "believed infeasible"
    return Outcome(case.name, robots, status, np.inf, seconds, "", *tried)


def outcomes(
    robots: Sequence[int], seeds: int, count: int, done: Sequence[Outcome]
) -> Iterator[Outcome]:
    """Yield what becomes of the random morphs, but those that are done."""
    names = {one.morph for one in done}
    for n in robots:
        for seed in range(seeds):
            if random_name(n, seed) in names:
                continue
            case = random_case(n, seed)
            if case is None:
                yield Outcome(random_name(n, seed), n, "ends")
            else:
                yield outcome(case, n, count)


def named_outcomes(count: int, done: Sequence[Outcome]) -> Iterator[Outcome]:
    """Yield what becomes of the named morphs, but those that are done."""
    names = {one.morph for one in done}
    for case in named_cases():
        if case.name not in names:
            yield outcome(case, 0, count)


def read(path: Path) -> list[Outcome]:
    """Return the outcomes that a table holds; none where there is no table."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Outcome(
                row["morph"],
                int(row["robots"]),
                row["status"],
                float(row["duration"]),
                float(row["search"]),
                row["guess"],
                int(row["restarts"]),
                int(row["found"]),
                int(row["capped"]),
                float(row["best"]),
            )
            for row in csv.DictReader(file)
        ]


def report(done: Sequence[Outcome], load: float) -> list[str]:
    """Return the lines of the tables, what they are worth first."""
    lines = [
        "# Hard morphs",
        "",
        f"- {date.today().isoformat()}; {environment()}",
        f"- busy before the start: {load:.1f} processes on average over a minute",
        f"- limitations: {LIMITATIONS}",
        f"- rounds of the search: {', '.join(str(how) for how in ROUNDS)}",
        "",
        "| n | morphs | solved | ends | failed | believed infeasible | search, median [s] | "
        "most [s] |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    random = [one for one in done if one.robots]
    for n in [*sorted({one.robots for one in random}), 0]:
        some = [one for one in random if n in (one.robots, 0)]
        if not some:
            continue
        statuses = [one.status for one in some]
        tried = [one.search for one in some if one.status != "ends"] or [0.0]
        names = ("solved", "ends", "failed", "believed infeasible")
        counts = " | ".join(str(statuses.count(name)) for name in names)
        spread = f"{np.median(tried):.2f} | {np.max(tried):.2f}"
        lines.append(f"| {n or 'all'} | {len(some)} | {counts} | {spread} |")
    lines += [
        f"| {one.morph} | {one.status}: of {one.restarts} restarts {one.found} found a way, "
        f"{one.capped} were stopped | | | | | | |"
        for one in random
        if one.status in ("failed", "believed infeasible")
    ]
    named = [one for one in done if not one.robots]
    if named:
        lines += [
            "",
            "| named morph | flight [s] | search [s] | best restart [s] | longer than it | "
            "restarts | that found a way | stopped |",
            "| --- | --- | --- | --- | --- | --- | --- | --- |",
        ]
    lines += [
        f"| {one.morph} | {one.duration:.3f} | {one.search:.2f} | {one.best:.3f} | "
        f"{one.duration / one.best - 1.0:+.1%} | {one.restarts} | {one.found} | {one.capped} |"
        for one in named
    ]
    return lines


def main() -> None:
    """Write the random morphs' and the named ones' outcomes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="random morphs for every n")
    parser.add_argument("--restarts", type=int, default=50)
    parser.add_argument("--robots", type=int, nargs="*", default=list(range(3, 13)))
    parser.add_argument("--named", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/results"))
    arguments = parser.parse_args()
    load = busy()
    print(f"{environment()}\nlimitations: {LIMITATIONS}", flush=True)
    arguments.output.mkdir(parents=True, exist_ok=True)
    path = arguments.output / "hard_morphs.csv"
    done = read(path)
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Outcome)])
        if file.tell() == 0:
            writer.writeheader()
        count = arguments.restarts
        random = outcomes(arguments.robots, arguments.seeds, count, done)
        for one in chain(random, named_outcomes(count, done) if arguments.named else ()):
            done.append(one)
            writer.writerow(asdict(one))
            file.flush()
            print(f"{one.morph:24s} {one.status} {one.duration:.3f} {one.search:.2f}", flush=True)
    lines = report(done, load)
    table = arguments.output / "hard_morphs.md"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
