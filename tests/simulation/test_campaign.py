"""Campaigns: success rates with their uncertainty, and the same run for the same seed alone."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripted import regular_hitch, standing, unformed

from hitchopt.errors import InputError
from hitchopt.simulation.judgement import FAILED, NOT_SIMULATED, SUCCEEDED, Run, simulate
from hitchopt.simulation.settings import Perturbations, Settings
from hitchopt.simulation.task import Task
from hitchopt.sweeps.campaign import Campaign, run_campaign, save_campaign

BRIEF = Settings(
    body="point",
    perturbations=Perturbations(noise=0.005, start_error=0.01),
    pull_test=False,
    seed=40,
)


@pytest.fixture(scope="module")
def task() -> Task:
    """Return a hitch at rest that, by its plan, should move at the end."""
    task = standing(regular_hitch(3), 0.05)
    vertices = task.vertices.copy()
    vertices[4:, :, 0] += [[0.01], [0.02]]
    return replace(task, vertices=vertices, digest="abc")


def interval(successes: int, runs: int) -> tuple[float, float]:
    verdicts = [SUCCEEDED] * successes + [FAILED] * (runs - successes)
    return Campaign(BRIEF, tuple(Run(i, v, ()) for i, v in enumerate(verdicts)), "").interval


def without_nan(run: Run) -> Run:
    """Return a run without its pace and the figures of objects, which are nan."""
    return replace(run, pace=0.0, placed=0.0, tilted=0.0, slipped=0.0)


@pytest.mark.slow
def test_several_processes_give_the_runs_that_one_gives(task: Task, tmp_path: Path) -> None:
    messages: list[str] = []
    campaign = run_campaign(task, BRIEF, 2, processes=2, progress=messages.append)
    alone = simulate(task, BRIEF)
    assert [run.seed for run in campaign.runs] == [40, 41]
    assert without_nan(campaign.runs[0]) == without_nan(alone.run)
    assert campaign.runs[0].tracking != campaign.runs[1].tracking
    np.testing.assert_allclose(interval(8, 10), (0.4902, 0.9433), atol=5e-5)  # the paper's
    assert campaign.successes == 2
    assert messages[-1] == "2 of 2 flown, 2 succeeded"
    save_campaign(tmp_path, campaign)
    content = json.loads((tmp_path / "campaign.json").read_text(encoding="utf-8"))
    assert content["successes"] == content["runs"] == 2
    assert content["rate_95_percent"] == list(interval(2, 2))
    assert content["setpoints_sha256"] == "abc"
    assert content["settings"]["perturbations"]["noise"] == 0.005
    with (tmp_path / "runs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["40", "41"]
    assert [row["verdict"] for row in rows] == ["succeeded", "succeeded"]
    done = alone.errors
    moves = (done.t > 0.035) & (done.t < 0.055)
    for name, chosen in (("moving", moves), ("resting", ~moves), ("vertex_error", moves | True)):
        expected = np.mean(done.errors[chosen])
        assert float(rows[0][f"{name}_mean"]) == pytest.approx(expected, rel=1e-5)
    assert float(rows[0]["without_sag_mean"]) < float(rows[0]["vertex_error_mean"])
    assert float(rows[0]["tracking_mean"]) == pytest.approx(alone.run.tracking.mean, rel=1e-5)


def test_flights_that_cannot_begin_are_failures_of_that_run(task: Task) -> None:
    free = unformed(standing(regular_hitch(3), 0.05))
    apart = replace(free.setpoints, positions=free.setpoints.positions * 1.6)
    campaign = run_campaign(replace(free, setpoints=apart), BRIEF, 2, processes=1)
    assert campaign.successes == 0
    assert campaign.failures == {("start", ""): 2}
    assert [run.verdict for run in campaign.runs] == [NOT_SIMULATED] * 2
    assert campaign.to_dict()["not_simulated"] == campaign.not_simulated == 2
    assert "its drones start" in campaign.runs[0].failures[0].words
    assert isinstance(campaign, Campaign)
    heavy = replace(BRIEF, density=1e-6)
    with pytest.raises(InputError, match="time_step"):  # nobody could fly this
        run_campaign(task, heavy, 2, processes=1)
    for runs, processes, name in ((0, None, "runs"), (1, 0, "processes")):
        with pytest.raises(InputError, match=f"^{name} = 0"):
            run_campaign(task, BRIEF, runs, processes)
