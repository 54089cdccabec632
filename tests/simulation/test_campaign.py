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
from hitchopt.sweeps.campaign import Campaign, run_campaign, save_campaign

NOISY = Perturbations(noise=0.005, start_error=0.01)
BRIEF = Settings(perturbations=NOISY, pull_test=False, seed=40)


@pytest.mark.slow
def test_several_processes_give_the_runs_that_one_gives(tmp_path: Path) -> None:
    task = standing(regular_hitch(3), 0.05)
    vertices = task.vertices.copy()
    vertices[4:, :, 0] += [[0.01], [0.02]]  # by its plan it should move at the end
    task, messages = replace(task, vertices=vertices), list[str]()
    campaign = run_campaign(task, BRIEF, 2, processes=2, progress=messages.append)
    alone = simulate(task, BRIEF)
    for name, value in alone.figures.items():
        np.testing.assert_equal(campaign.runs[0].figures[name], value)
    assert campaign.runs[0].figures["tracking_mean"] != campaign.runs[1].figures["tracking_mean"]
    runs = tuple(Run(i, SUCCEEDED if i < 8 else FAILED, (), {}) for i in range(10))
    np.testing.assert_allclose(Campaign(BRIEF, runs).interval, (0.4902, 0.9433), atol=5e-5)
    assert messages[-1] == "2 of 2 flown, 2 succeeded"
    save_campaign(tmp_path, campaign)
    content = json.loads((tmp_path / "campaign.json").read_text(encoding="utf-8"))
    assert content["successes"] == content["runs"] == campaign.successes == 2
    assert content["rate_95_percent"] == list(campaign.interval)
    assert content["settings"]["perturbations"]["noise"] == 0.005
    with (tmp_path / "runs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["seed"], row["verdict"]) for row in rows] == [(s, SUCCEEDED) for s in ("40", "41")]
    done = alone.errors
    moves = (done.t > 0.035) & (done.t < 0.055)
    for name, chosen in (("moving", moves), ("resting", ~moves), ("vertex_error", moves | True)):
        expected = np.mean(done.errors[chosen])
        assert float(rows[0][f"{name}_mean"]) == pytest.approx(expected, rel=1e-5)
    assert float(rows[0]["without_sag_mean"]) < float(rows[0]["vertex_error_mean"])


def test_flights_that_cannot_begin_are_failures_of_that_run(tmp_path: Path) -> None:
    free = unformed(standing(regular_hitch(3), 0.05))
    apart = replace(free.setpoints, positions=free.setpoints.positions * 1.6)
    campaign = run_campaign(replace(free, setpoints=apart), BRIEF, 2, processes=1)
    assert campaign.successes == 0
    assert campaign.failures == {("start", ""): 2}
    assert [run.verdict for run in campaign.runs] == [NOT_SIMULATED] * 2
    assert campaign.to_dict()["not_simulated"] == campaign.not_simulated == 2
    save_campaign(tmp_path, campaign)
    assert (tmp_path / "runs.csv").read_text(encoding="utf-8").count("its drones start") == 2
    with pytest.raises(InputError, match="time_step"):  # nobody could fly this
        run_campaign(free, replace(BRIEF, density=1e-6), 2, processes=1)
    for runs, processes, name in ((0, None, "runs"), (1, 0, "processes")):
        with pytest.raises(InputError, match=f"^{name} = 0"):
            run_campaign(free, BRIEF, runs, processes)
