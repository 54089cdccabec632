"""Replayed filters believe what the drone's own filter believed, and see the pull or not."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import writers as w
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.hitch.estimator import ONE_MARKER
from hitchopt.lab.flights.replay import cable_pulls
from hitchopt.lab.simulation.estimator import Filter
from hitchopt.values import Array

GRAVITY, MASS, LOAD = 9.81, 0.035, 0.01


def carried(seconds: float = 7.0, tilt_deg: float = 0.0, seed: int = 0) -> ho.RecordedFlight:
    """Return a flight of two drones with a load, as the firmware's filter for one marker logs it.

    Gyroscopes show fast changes of the pull, so the load swings slowly.
    Rigid bodies, whose attitudes are captured, are defined tilted.
    """
    t = np.arange(0.0, seconds, 0.01)
    wave = np.stack([0.4 * np.sin(1.2 * t), 0.2 * np.sin(1.7 * t), 0.05 * np.sin(t)], axis=1)
    swing = np.stack([0.06 * np.sin(0.5 * t), 0.05 * np.sin(0.4 * t + 1.0), 0.0 * t], axis=1)
    places = [wave + [0.3, 0.0, 1.0], wave + [-0.3, 0.0, 1.0]]
    load = wave + swing + [0.0, 0.0, 0.6]
    tracks = {f"cf{k}": ho.Track(t, place) for k, place in enumerate(places)}
    flight = ho.RecordedFlight("carried", tracks, loads={"load": ho.Track(t, load)})
    signals, rng = dict[str, dict[str, ho.Signal]](), np.random.default_rng(seed)
    for (name, track), pull in zip(tracks.items(), cable_pulls(flight, t, LOAD), strict=True):
        attitude, rates, force = _sensed(t, track.positions, pull / MASS)
        noisy = rates + 0.01 * rng.standard_normal(rates.shape)
        velocity = np.gradient(track.positions, t, axis=0)
        filters = Filter(ONE_MARKER, track.positions[:1], velocity[:1], attitude[:1])
        believed = [attitude[0]]
        for i in range(1, len(t)):
            filters.advance(0.5 * (noisy[i - 1 : i] + noisy[i : i + 1]), force[i : i + 1, 2], 0.01)
            filters.observe(track.positions[i : i + 1])
            believed.append(filters.attitudes[0])
        body = Rotation.from_euler("y", math.radians(tilt_deg)).as_matrix()
        values = {
            "attitude": Rotation.from_matrix(attitude @ body).as_quat(),
            "estimated_attitude": Rotation.from_matrix(np.stack(believed)).as_quat(),
            "estimated_velocity": velocity,
            "rates": noisy,
            "specific_force": force,
        }
        signals[name] = {quantity: ho.Signal(t, each) for quantity, each in values.items()}
    return replace(flight, signals=signals)


def _sensed(t: Array, place: Array, pull: Array) -> tuple[Array, Array, Array]:
    """Return attitudes, rates and specific forces of a drone under accelerations by a pull."""
    acceleration = np.gradient(np.gradient(place, t, axis=0), t, axis=0)
    lift = acceleration + [0.0, 0.0, GRAVITY] - pull
    up = lift / np.linalg.norm(lift, axis=1, keepdims=True)
    side = np.cross(up, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    attitude = np.stack([np.cross(side, up), side, up], axis=2)
    relative = attitude[:-1].transpose(0, 2, 1) @ attitude[1:]
    turns = Rotation.from_matrix(relative).as_rotvec() / 0.01
    rates = np.stack([np.interp(t, 0.5 * (t[1:] + t[:-1]), x) for x in turns.T], axis=1)
    force = np.einsum("iba,ib->ia", attitude, acceleration + [0.0, 0.0, GRAVITY])
    return attitude, rates, force


def by_name(replays: tuple[ho.ReplayedFilter, ...]) -> dict[tuple[str, str], ho.ReplayedFilter]:
    return {(each.drone, each.filter): each for each in replays}


def test_filters_are_replayed() -> None:
    """One marker is blind to the pull, as the drone was; the exported filter is not."""
    flight = carried()
    replays = by_name(ho.replay_filters(flight))
    for name in flight.tracks:
        stock, exported = replays[name, "stock, one marker"], replays[name, "exported"]
        assert stock.logged_rms_deg < 0.1
        assert stock.captured_rms_deg > 1.5
        assert abs(stock.pull_seen) < 0.3
        assert exported.captured_rms_deg < 0.3
        assert exported.logged_rms_deg > 1.5
        assert exported.pull_seen == pytest.approx(1.0, abs=0.05)
        assert exported.seconds > 5.0


def test_the_exported_filter_believes_a_tilted_rigid_body() -> None:
    tilted = by_name(ho.replay_filters(carried(tilt_deg=8.0)))
    assert tilted["cf0", "exported"].captured_rms_deg < 0.5
    assert tilted["cf0", "exported"].logged_rms_deg > 6.0
    assert tilted["cf0", "stock, one marker"].captured_rms_deg > 6.0


def test_logs_without_captured_attitudes_are_replayed(tmp_path: Path) -> None:
    """The attitude trails the gyroscope; accelerometers may be missing."""
    flight = carried()
    late = {
        name: {
            **{x: y for x, y in own.items() if x != "attitude"},
            "estimated_attitude": ho.Signal(
                own["estimated_attitude"].t,
                own["estimated_attitude"].at(own["estimated_attitude"].t - 0.01),
            ),
        }
        for name, own in flight.signals.items()
    }
    flight = replace(flight, signals=late)
    for drop in ("", "acc."):
        logs = w.write_rich_usd(tmp_path / f"logs{drop}", flight, (0.0, 40.0), drop)
        for each in ho.replay_filters(logs):
            if each.filter == "stock, one marker":
                assert each.logged_rms_deg < 0.3
                assert abs(each.pull_seen) < 0.3
            else:
                assert math.isnan(each.captured_rms_deg)
                assert "no captured attitude is recorded" in each.remark
                assert each.pull_seen == pytest.approx(1.0, abs=0.05)


def test_a_steady_pull_is_unseen_by_one_marker() -> None:
    replays = by_name(ho.replay_filters(replace(carried(9.0), loads={})))
    assert abs(replays["cf0", "stock, one marker"].pull_seen) < 0.3
    assert replays["cf0", "exported"].pull_seen == pytest.approx(1.0, abs=0.05)


def test_recordings_without_sensors_are_refused(tmp_path: Path) -> None:
    bag = w.write_crazyswarm(tmp_path / "a.bag", w.rich_sample(1))
    with pytest.raises(ho.FileError, match=r"ROS 1 bag: holds .*motors: filters need rates"):
        ho.replay_filters(bag)


def test_the_command_prints_filters(tmp_path: Path) -> None:
    logs = w.write_rich_usd(tmp_path / "logs", carried(4.0))
    result = CliRunner().invoke(main, ["evaluate", str(logs), "--filter", "--json"])
    assert result.exit_code == 0, result.output
    filters = json.loads(result.stdout)["filters"]
    names = [each["filter"] for each in filters[:3]]
    assert names == ["stock, one marker", "stock, rigid body", "exported"]
    assert filters[0]["logged_rms_deg"] < 0.1
    assert filters[2]["captured_rms_deg"] is None
