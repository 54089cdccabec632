"""The benchmarks' page: failures are counted and have no times, and interrupted runs go on."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.libraries import counted_calls, lines, problems
from benchmarks.page import (
    Result,
    Store,
    cell,
    family_rows,
    morph_rows,
    page,
    proof_rows,
    proven_of,
)


def store_of(folder: Path, *results: Result) -> Store:
    """Return a store with results."""
    store = Store.opened(folder / "page.jsonl", again=False)
    for result in results:
        store.add(result)
    return store


def plan(index: int, n: int, seconds: float, *, method: str = "routed") -> Result:
    """Return the result of a pair that was planned and proven."""
    return Result("morph", method, index, n, seconds, True, True, 0.02 * n, 0.2 * n)


def refused(index: int, n: int, seconds: float, *, method: str = "routed") -> Result:
    """Return the result of a pair that was refused."""
    return Result("morph", method, index, n, seconds, False, remark="cable")


def test_failures_count_but_have_no_times() -> None:
    results = [plan(0, 3, 1.0), plan(1, 3, 3.0), refused(2, 3, 70.0)]
    assert cell(results) == f"2/3: 2–{np.percentile([1.0, 3.0], 95):.2g}"
    assert cell([refused(0, 3, 70.0)]) == "0/1: –"
    assert cell([]) == "–"


def test_rows_are_by_method_and_number_of_robots(tmp_path: Path) -> None:
    store = store_of(tmp_path, plan(0, 3, 1.0), plan(1, 11, 4.0), refused(2, 11, 9.0))
    routed = list(morph_rows(store))[1]
    assert routed[1] == "1/1: 1–1"
    assert routed[2] == "–"
    assert routed[-2] == "1/2: 4–4"
    assert routed[-1].startswith("2/3: 2.5–")


def test_proofs_are_those_of_solved_pairs(tmp_path: Path) -> None:
    results = [plan(index, n, 1.0) for index, n in enumerate([*range(3, 10), 9])]
    certify, verify = proof_rows(store_of(tmp_path, *results, refused(20, 5, 9.0)))
    assert certify[1:4] == ["0.07–0.079", "0.11–0.12", "0.15–0.16"]
    assert verify[-2] == "1.8–1.8"


def test_families_count_planned_and_proven_ones(tmp_path: Path) -> None:
    form = [
        Result("family", "form", seed, 3 + seed % 2, 1.0, seed < 3, seed < 2) for seed in range(4)
    ]
    store = store_of(tmp_path, *form)
    (row,) = family_rows(store)
    assert row == ["`form`", "3/4", "1–1", "–"]
    ratios = [replace(each, over_bound=1.0 + each.index) for each in form]
    ((*_, over_bound),) = family_rows(store_of(tmp_path / "ratios", *ratios))
    assert over_bound == "2.50–4.00"
    assert proven_of(store.of("form")) == "2 of 3"


@pytest.mark.parametrize("again", [False, True])
def test_an_interrupted_run_goes_on(tmp_path: Path, again: bool) -> None:
    store_of(tmp_path, plan(0, 3, 1.0))
    store = Store.opened(tmp_path / "page.jsonl", again=again)
    assert store.has("routed", 0) is not again
    assert not store.has("routed", 1)
    assert not store.has("optimised", 0)


def test_the_page_has_at_most_four_tables_and_two_figures(tmp_path: Path) -> None:
    results = [plan(index, n, 1.0) for index, n in enumerate([*range(3, 10)])]
    calls = {"morph": Counter({"toppra `TOPPRA`": 25}), "form": Counter({"ruckig `Ruckig`": 1600})}
    text = page(store_of(tmp_path, *results), 10.0, "a machine", calls)
    assert "a machine, " in text
    assert text.count("\n|---") <= 4
    assert text.count("![") <= 2
    assert "10 s per pair" in text
    assert "- form: ruckig `Ruckig` 1,600\n" in text


def test_calls_of_libraries_are_counted_by_name() -> None:
    """A routed morph differentiates the model in programs; its motion is timed by toppra."""
    with counted_calls() as calls:
        problems()["morph"]()
    assert calls["casadi `derivatives`"] > 0
    assert calls["casadi `program`"] >= calls["casadi `derivatives`"]
    assert calls["toppra `TOPPRA`"] > 0
    assert calls["ruckig `Ruckig`"] == 0
    (line,) = lines({"morph": calls})
    assert line.startswith("- morph: casadi `derivatives` ")
