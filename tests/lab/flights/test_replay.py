"""Replayed filters believe what the drone's own filter believed, and see the pull or not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.replay import ReplayedFilter, main, replay_filters, tilt_rms_deg
from hitchopt.errors import FileError
from hitchopt.lab.flights.recordings import Signal
from tests.helpers import writers as w
from tests.helpers.load_flights import carried


def by_name(replays: tuple[ReplayedFilter, ...]) -> dict[tuple[str, str], ReplayedFilter]:
    return {(each.drone, each.filter): each for each in replays}


def test_filters_are_replayed() -> None:
    """One marker is blind to the pull, as the drone was; the exported filter is not."""
    flight = carried()
    replays = by_name(replay_filters(flight))
    for name in flight.tracks:
        stock, exported = replays[name, "stock, one marker"], replays[name, "exported"]
        assert stock.logged_rms_deg < 0.1
        assert stock.captured_rms_deg > 1.5
        assert abs(stock.pull_seen) < 0.3
        assert exported.captured_rms_deg < 0.3
        assert exported.logged_rms_deg > 1.5
        assert exported.pull_seen == pytest.approx(1.0, abs=0.05)
        assert exported.seconds > 5.0


@pytest.mark.slow
def test_the_exported_filter_believes_a_tilted_rigid_body() -> None:
    tilted = by_name(replay_filters(carried(tilt_deg=8.0)))
    assert tilted["cf0", "exported"].captured_rms_deg < 0.5
    assert tilted["cf0", "exported"].logged_rms_deg > 6.0
    assert tilted["cf0", "stock, one marker"].captured_rms_deg > 6.0


@pytest.mark.slow
def test_logs_without_captured_attitudes_are_replayed(tmp_path: Path) -> None:
    """The attitude trails the gyroscope; accelerometers may be missing."""
    flight = carried()
    late = {
        name: {
            **{x: y for x, y in own.items() if x != "attitude"},
            "estimated_attitude": Signal(
                own["estimated_attitude"].t,
                own["estimated_attitude"].at(own["estimated_attitude"].t - 0.01),
            ),
        }
        for name, own in flight.signals.items()
    }
    flight = replace(flight, signals=late)
    for drop in ("", "acc."):
        logs = w.write_rich_usd(tmp_path / f"logs{drop}", flight, (0.0, 40.0), drop)
        for each in replay_filters(logs):
            if each.filter == "stock, one marker":
                assert each.logged_rms_deg < 0.3
                assert abs(each.pull_seen) < 0.3
            else:
                assert math.isnan(each.captured_rms_deg)
                assert "no captured attitude is recorded" in each.remark
                assert each.pull_seen == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_steady_pull_is_unseen_by_one_marker() -> None:
    replays = by_name(replay_filters(replace(carried(9.0), loads={})))
    assert abs(replays["cf0", "stock, one marker"].pull_seen) < 0.3
    assert replays["cf0", "exported"].pull_seen == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 3.0, 60.0, 90.0, 150.0, 180.0])
def test_tilts_are_angles_of_any_size(degrees: float) -> None:
    angle = math.radians(degrees)
    one = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    other = Rotation.from_rotvec([0.0, angle, 0.0]).apply(one)
    assert tilt_rms_deg(one, other) == pytest.approx(degrees, rel=1e-9, abs=1e-12)


def test_recordings_without_sensors_are_refused(tmp_path: Path) -> None:
    bag = w.write_crazyswarm(tmp_path / "a.bag", w.rich_sample(1))
    with pytest.raises(FileError, match=r"ROS 1 bag: holds .*motors: filters need rates"):
        replay_filters(bag)


def test_the_command_prints_filters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = w.write_rich_usd(tmp_path / "logs", carried(4.0))
    monkeypatch.setenv("COLUMNS", "120")
    main([str(logs)])
    printed = capsys.readouterr().out
    for name in ("stock, one marker", "stock, rigid body", "exported"):
        assert name in printed
