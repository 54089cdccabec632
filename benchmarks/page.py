"""The documentation's page of benchmarks: success and solve times, in tables and a figure.

Usage: python -m benchmarks page [--problems N] [--limit SECONDS] [--again]

Morphs are the pairs of ``problems/irregular_pairs.json``, planned with their ends; rivals get the
ends and at most the same processor time. Families are those of ``benchmarks.families``. Results are
stored as they come, in page.jsonl next to the tables: an interrupted run continues from there, and
``--again`` starts over. Failures count as failures and have no times.
"""

from __future__ import annotations

import datetime
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np

import hitchopt as ho
from benchmarks.families import FAMILIES, outcome
from benchmarks.libraries import counts, lines
from benchmarks.measuring import ROOT, environment, parser, timed
from benchmarks.rival import Rival, RivalError, RivalFlight
from hitchopt import verify
from hitchopt.view.style import COLOURS
from problems.random_morph import irregular_pairs
from problems.swarm import square_mission

if TYPE_CHECKING:
    from benchmarks.rockit_rival import RockitRival

PAGE = ROOT / "docs" / "benchmarks"

METHODS = {
    "straight": "`ho.morph`, straight path kept",
    "routed": "`ho.morph`, routed",
    "optimised": "`ho.morph(optimize=True)`",
    "ipopt": "plain casadi and IPOPT, by us, warm",
    "seeded": "the same, from our plan",
    "rockit": "rockit-meco and IPOPT, warm",
}
"""Methods and their names on the page."""

SHORT_METHODS = {
    "straight": "straight",
    "routed": "routed",
    "optimised": "optimised",
    "ipopt": "casadi, IPOPT",
    "seeded": "from our plan",
    "rockit": "rockit, IPOPT",
}
"""Names of methods in figures."""

OURS = ("straight", "routed", "optimised")

SHARES = {
    1: ("straight", "routed"),
    2: ("optimised",),
    3: ("ipopt",),
    4: ("seeded",),
    5: ("rockit",),
}
"""Methods by the index of the colour of their share of solved pairs; a pair is flown straight or routed."""

MARKERS = {
    "straight": "v",
    "routed": "s",
    "optimised": "o",
    "ipopt": "D",
    "seeded": "d",
    "rockit": "^",
}
"""Markers of methods in figures."""

SHIFT = 0.1
"""Shift of a method's marks from another one's along the axis of robots."""

WIDTH = 5.0
"""Width of figures [inch]: text of 10 pt is 11 pixels high on a screen of 400 pixels."""

DPI = 160
"""Resolution of figures."""

MAX_RIVAL_ROBOTS = 6
"""Largest number of robots that rivals get: most larger ones reach the limit of time."""

COLUMNS = [range(3, 5), range(5, 7), range(7, 9), range(9, 13)]
"""Numbers of robots of the tables' columns."""

SIZES = [*(range(n, n + 1) for n in range(3, 9)), range(9, 13)]
"""Numbers of robots of the figure's marks."""

SHOWN_FAMILIES = (
    "form",
    "carry",
    "morph",
    "heavy_morph",
    "past_pillars",
    "box",
    "door",
    "corridor",
)

MISSIONS = [
    (drones, radius, seed)
    for seed in (None, 0, 1)
    for drones, radii in {
        8: (0.15, 0.3),
        16: (0.15, 0.25),
        32: (0.12, 0.15),
        64: (0.12, 0.15),
    }.items()
    for radius in radii
]
"""Missions of single drones: number of drones, their radius [m], and seed of a forest, or None."""

PUBLISHED = {16: "about 1", 64: "less than 60"}
"""Processor times [s] in forests that the authors of the missions state, by number of drones."""

MISSIONS_TEXT = (
    "Starts, goals and sizes of missions published with RBP (Park, ICRA 2020): planned/all, median "
    "makespan: median–longest processor time [s]; {proven} plans are proven. RBP's times are for its "
    "machine, limits and forests."
)

LIMITS = (
    "Limits and tolerances are the defaults; plans are certified for all times. Rivals have no "
    "jerk limits or cable clearances, exceed "
    "limits between their samples by up to {excess:.1f} %, and get {limit:g} s per pair, excluding "
    "setup. Failures have no times."
)

FAMILIES_TEXT = (
    "Problems of `python -m benchmarks families`; starts and goals are certified first, those of "
    "`carry` drawn by geometry alone, none is omitted, {proven} plans are proven. Over bound, "
    "median–largest: duration over what each phase's slowest drone or vertex takes alone within "
    "speed and acceleration."
)

LIBRARIES_TEXT = (
    "Calls by planning (`python -m benchmarks libraries`). casadi's `program` is PIQP; others are "
    "the model's."
)


@dataclass(frozen=True)
class Result:
    """The outcome of one method on one problem."""

    group: str  # "morph" or "family"
    method: str  # method, or name of the family
    index: int  # pair or seed
    size: int  # number of robots, or of single drones
    seconds: float  # processor time [s]
    solved: bool
    proven: bool = False  # also by ``hitchopt verify``
    certify: float | None = None  # processor time of the certificate [s]
    verify: float | None = None  # processor time of ``hitchopt verify`` [s]
    excess: float | None = None  # of limits between a rival's samples, relative
    makespan: float | None = None  # of single drones [s]
    over_bound: float | None = None  # duration of a family's plan over its lower bound
    remark: str = ""


@dataclass
class Store:
    """Results in a file of lines, which is read again by the next run."""

    path: Path
    results: list[Result] = field(default_factory=list)

    @classmethod
    def opened(cls, path: Path, *, again: bool) -> Store:
        """Return the store with the results of earlier runs, or empty."""
        path.parent.mkdir(parents=True, exist_ok=True)
        if again or not path.exists():
            path.write_text("", encoding="utf-8")
        lines = path.read_text(encoding="utf-8").splitlines()
        return cls(path, [Result(**json.loads(line)) for line in lines])

    def has(self, method: str, index: int) -> bool:
        """Return whether a problem has a result by a method."""
        return any(each.method == method and each.index == index for each in self.results)

    def add(self, result: Result) -> None:
        """Store and print a result."""
        self.results.append(result)
        line = json.dumps(asdict(result))
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")
        print(line, file=sys.stderr, flush=True)

    def of(self, *methods: str, sizes: Collection[int] | None = None) -> list[Result]:
        """Return the results of methods, or of their problems of some sizes."""
        return [
            each
            for each in self.results
            if each.method in methods and (sizes is None or each.size in sizes)
        ]


@dataclass(frozen=True, eq=False)
class Pair:
    """A pair of irregular polygons."""

    data: dict[str, Any]

    def hitch(self, key: str) -> ho.Hitch:
        """Return the hitch with spread legs at the pair's start or goal."""
        team = ho.Team(self.data["n"], self.data["cable_length"])
        return ho.Hitch.spread(team, self.data[key], self.data["altitude"])

    def plan(self, optimize: bool) -> ho.Plan:
        """Return the plan of the morph."""
        return ho.morph(self.hitch("start"), self.data["goal"], optimize=optimize)

    @cached_property
    def ends(self) -> tuple[ho.Hitch, ho.Hitch]:
        """Hitches at start and goal, for rivals."""
        return self.hitch("start"), self.hitch("goal")


def planned(pair: Pair, index: int, *, optimize: bool) -> Result:
    """Return the result of a morph by this package."""
    n, start_time = pair.data["n"], time.process_time()
    try:
        plan = pair.plan(optimize)
    except ho.InfeasibleError as error:
        seconds = time.process_time() - start_time
        method = "optimised" if optimize else "routed"
        return Result("morph", method, index, n, seconds, False, remark=str(error).splitlines()[0])
    seconds = time.process_time() - start_time
    method = "optimised" if optimize else "routed" if plan.phases[0].remark else "straight"
    certificate, certify_time = timed(lambda: ho.certify(plan.motion))
    proven, verify_time = proof(plan)
    return Result(
        "morph", method, index, n, seconds, certificate.certified, proven, certify_time, verify_time
    )


def proof(plan: ho.Plan) -> tuple[bool, float]:
    """Return whether ``hitchopt verify`` proves a plan, and its processor time [s]."""
    with tempfile.TemporaryDirectory() as folder:
        plan.save(folder)
        rows, seconds = timed(lambda: list(verify.verify(folder)))
    return all(row.verdict in verify.PASSING for row in rows), seconds


@dataclass
class Rivals:
    """Rivals by number of robots; the first problem of a size builds its program."""

    limit: float  # [s] Processor time
    warm: dict[tuple[str, int], Rival | RockitRival] = field(default_factory=dict)

    def of(self, method: str, team: ho.Team) -> Rival | RockitRival:
        """Return the rival for teams of a size, with its program built."""
        key = method, team.robots
        if key not in self.warm:
            from benchmarks.rockit_rival import RockitRival

            rival = Rival(team, ho.Limits(), ho.Separation(), self.limit)
            self.warm[key] = RockitRival(rival) if method == "rockit" else rival
        return self.warm[key]

    def solve(self, method: str, pair: Pair) -> Callable[[], RivalFlight]:
        """Return the call that solves a pair."""
        start, end = pair.ends
        rival = self.of(method, start.team)
        if isinstance(rival, Rival) and method == "seeded":
            return partial(rival.solve, start, end, pair.plan(optimize=False))
        return partial(rival.solve, start, end)

    def result(self, method: str, pair: Pair, index: int) -> Result:
        """Return the result of a rival, solved twice if its program is new."""
        n = pair.data["n"]
        is_new = (method, n) not in self.warm
        solve = self.solve(method, pair)
        for _ in range(2 if is_new else 1):
            start_time = time.process_time()
            try:
                excess, remark = solve().excess, ""
            except RivalError as error:
                excess, remark = None, str(error)
            seconds = time.process_time() - start_time
        solved = excess is not None
        return Result("morph", method, index, n, seconds, solved, excess=excess, remark=remark)


def measure(store: Store, problems: int, limit: float) -> None:
    """Measure everything that the store lacks."""
    pairs, rivals = [Pair(data) for data in irregular_pairs()], Rivals(limit)
    pairs[0].plan(optimize=True)  # imports are not measured
    for index, pair in enumerate(pairs):
        if not (store.has("straight", index) or store.has("routed", index)):
            store.add(planned(pair, index, optimize=False))
        if not store.has("optimised", index):
            store.add(planned(pair, index, optimize=True))
    for method in ("ipopt", "seeded", "rockit"):
        for index, pair in enumerate(pairs):
            if pair.data["n"] <= MAX_RIVAL_ROBOTS and not store.has(method, index):
                store.add(rivals.result(method, pair, index))
    for index in range(len(MISSIONS)):
        if not store.has("mission", index):
            store.add(flown(index))
    for family in SHOWN_FAMILIES:
        for seed in range(problems):
            if not store.has(family, seed):
                store.add(drawn(family, seed))


def drawn(family: str, seed: int) -> Result:
    """Return the result of a problem of a family."""
    one = outcome(FAMILIES[family](seed), seed)
    counts = one.size, one.seconds, one.duration is not None, one.proven
    ratio = one.over_bound
    return Result("family", family, seed, *counts, over_bound=ratio, remark=one.refusal)


def flown(index: int) -> Result:
    """Return the result of a mission of single drones."""
    one = outcome(square_mission(*MISSIONS[index]), index)
    solved = one.duration is not None
    return Result(
        "mission",
        "mission",
        index,
        one.size,
        one.seconds,
        solved,
        one.proven,
        makespan=one.duration,
        remark=one.refusal,
    )


def count(results: Sequence[Result]) -> str:
    """Return how many problems were solved, of how many."""
    return f"{sum(each.solved for each in results)}/{len(results)}"


def times(results: Sequence[Result]) -> str:
    """Return median and 95th percentile of the processor times of solved problems [s]."""
    seconds = [each.seconds for each in results if each.solved]
    return quantiles(seconds) if seconds else "–"


def quantiles(seconds: Sequence[float]) -> str:
    """Return the median and the 95th percentile."""
    return "{:.2g}–{:.2g}".format(*np.percentile(seconds, [50, 95]))


def cell(results: Sequence[Result]) -> str:
    """Return the cell of a method and a number of robots."""
    return f"{count(results)}: {times(results)}" if results else "–"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table between empty ones."""
    lines = [f"| {' | '.join(line)} |" for line in (head, *rows)]
    return ["", lines[0], "|---" * len(head) + "|", *lines[1:], ""]


def morph_rows(store: Store) -> Iterator[Sequence[str]]:
    """Yield the rows of morphs: methods by number of robots."""
    for method, name in METHODS.items():
        by_size = (cell(store.of(method, sizes=sizes)) for sizes in COLUMNS)
        yield [name, *by_size, cell(store.of(method))]


def proof_rows(store: Store) -> Iterator[Sequence[str]]:
    """Yield the rows of certificates and of ``verify``: processor times by number of robots."""
    for name in ("certify", "verify"):
        cells = []
        for sizes in (*COLUMNS, None):
            plans = [each for each in store.of(*OURS, sizes=sizes) if each.solved]
            seconds = [getattr(each, name) for each in plans]
            cells.append(quantiles(seconds))
        yield [f"`{name}`", *cells]


def family_rows(store: Store) -> Iterator[Sequence[str]]:
    """Yield the rows of families."""
    for family in SHOWN_FAMILIES:
        results = store.of(family)
        if not results:
            continue
        ratios = [each.over_bound for each in results if each.over_bound is not None]
        over_bound = f"{np.median(ratios):.2f}–{max(ratios):.2f}" if ratios else "–"
        yield [f"`{family}`", count(results), times(results), over_bound]


def proven_of(results: Sequence[Result]) -> str:
    """Return how many of the plans are proven by ``hitchopt verify``."""
    return f"{sum(each.proven for each in results)} of {sum(each.solved for each in results)}"


def mission_rows(store: Store) -> Iterator[Sequence[str]]:
    """Yield the rows of missions: in the open and in forests, by number of drones."""
    for size in sorted({drones for drones, _, _ in MISSIONS}):
        results = store.of("mission", sizes=[size])
        is_open = [MISSIONS[each.index][2] is None for each in results]
        in_the_open = [each for each, no_forest in zip(results, is_open, strict=True) if no_forest]
        in_forests = [each for each in results if each not in in_the_open]
        groups = mission_cell(in_the_open), mission_cell(in_forests)
        yield [str(size), *groups, PUBLISHED.get(size, "–")]


def mission_cell(results: Sequence[Result]) -> str:
    """Return the cell of missions: how many were planned, makespan and processor time [s]."""
    solved = [each for each in results if each.makespan is not None]
    if not solved:
        return count(results)
    makespan = np.median([each.makespan for each in solved if each.makespan is not None])
    seconds = [each.seconds for each in solved]
    return f"{count(results)}, {makespan:.3g}: {np.median(seconds):.2g}–{max(seconds):.2g}"


def mission_section(store: Store) -> list[str]:
    """Return the lines of the section of missions."""
    head = ["drones", "open", "forest", "RBP, forest"]
    text = MISSIONS_TEXT.format(proven=proven_of(store.of("mission")))
    return ["## Published missions", "", text, *table(head, mission_rows(store))]


def page(store: Store, limit: float, machine: str, calls: dict[str, Counter[str]]) -> str:
    """Return the page; the machine is described as before the measurements.

    ``calls`` are those of libraries by problem.
    """
    heads = [f"{sizes[0]}–{sizes[-1]}" for sizes in COLUMNS]
    excesses = [each.excess for each in store.results if each.excess is not None]
    return "\n".join(
        [
            "# Benchmarks",
            "",
            f"`python -m benchmarks page` wrote this page on {datetime.date.today()}: "
            f"{machine}, {os.getloadavg()[0]:.1f} after.",
            LIMITS.format(limit=limit, excess=100.0 * max(excesses, default=0.0)),
            "",
            "## Morphs of irregular pairs",
            "",
            "Solved/all pairs of `problems/irregular_pairs.json`: processor time, median–95th "
            "percentile [s].",
            *table(["method \\ n", *heads, "all"], morph_rows(store)),
            "![Solve times](solve_times.png)",
            "",
            "Times to prove these plans [s].",
            *table(["proof \\ n", *heads, "all"], proof_rows(store)),
            "(success-rates)=",
            "## Success rates",
            "",
            FAMILIES_TEXT.format(proven=proven_of(store.of(*SHOWN_FAMILIES))),
            *table(
                ["family", "planned", "time [s]", "over bound"],
                family_rows(store),
            ),
            *mission_section(store),
            "## What each library does",
            "",
            LIBRARIES_TEXT,
            "",
            *lines(calls),
            "",
        ]
    )


def draw(store: Store) -> None:
    """Draw the figure of solve times."""
    mpl.use("agg")
    from matplotlib import pyplot as plt

    middles = np.array([np.mean(sizes) for sizes in SIZES])
    figure, (time_axes, share_axes) = plt.subplots(
        2, 1, figsize=(WIDTH, 5.4), layout="constrained", sharex=True, height_ratios=(3, 2)
    )
    for number, (method, name) in enumerate(SHORT_METHODS.items()):
        places = middles + SHIFT * (number - 2)
        groups = [store.of(method, sizes=sizes) for sizes in SIZES]
        seconds = [[each.seconds for each in group if each.solved] for group in groups]
        solved = [k for k, group in enumerate(seconds) if group]
        medians = np.array([np.median(seconds[k]) for k in solved])
        highest = np.array([np.percentile(seconds[k], 95) for k in solved])
        spread = np.stack([np.zeros(len(solved)), highest - medians])
        style = {"color": COLOURS[number], "fmt": MARKERS[method], "capsize": 3}
        time_axes.errorbar(places[solved], medians, spread, label=name, **style)
    for colour, methods in SHARES.items():
        groups = [store.of(*methods, sizes=sizes) for sizes in SIZES]
        tried = [k for k, group in enumerate(groups) if group]
        shares = [100.0 * np.mean([each.solved for each in groups[k]]) for k in tried]
        # Our shares coincide: hollow marks leave those below visible
        style = {"marker": MARKERS[methods[-1]], "color": COLOURS[colour], "fillstyle": "none"}
        size = 10.0 if methods[-1] == "routed" else 6.0
        share_axes.plot(middles[tried], shares, markersize=size, **style)
    time_axes.set(yscale="log", ylabel="processor time [s]\n(median to 95 %)")
    share_axes.set(ylim=(0.0, 110.0), xlabel="robots n", ylabel="solved pairs [%]")
    share_axes.set_xticks(
        middles, [f"{sizes[0]}–{sizes[-1]}" if len(sizes) > 1 else f"{sizes[0]}" for sizes in SIZES]
    )
    for axes in (time_axes, share_axes):
        axes.grid(visible=True, alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0, handletextpad=0.3)
    figure.savefig(PAGE / "solve_times.png", dpi=DPI)
    plt.close(figure)


def main() -> None:
    """Measure what is missing, and write page and figure."""
    cli = parser(__doc__, problems=40, limit=10.0)
    cli.add_argument("--again", action="store_true", help="forget results of earlier runs")
    options = cli.parse_args()
    store = Store.opened(options.output / "page.jsonl", again=options.again)
    machine = environment(["rockit-meco"])
    measure(store, options.problems, options.limit)
    (PAGE / "index.md").write_text(page(store, options.limit, machine, counts()), encoding="utf-8")
    draw(store)
