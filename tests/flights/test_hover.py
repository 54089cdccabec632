"""Trims, tilts, thrust factors and lags of simulated hovers are recovered, without a plan."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.lab.cli import estimates  # noqa: F401, declares the command
from hitchopt.lab.flights.hover import DroneHover, calibrate_hover
from hitchopt.lab.flights.recordings import RecordedFlight, Signal, Track
from tests.helpers import writers as w
from tests.helpers.hovers import KD, KP, MASS, Hover, flown, random_hover

GAINS: Any = {"mass": MASS, "kp": KP, "kd": KD}
COVERED = math.sqrt(2.0 * math.log(20.0))  # Standard errors that hold 95 % of level distances
CASES: list[dict[str, Any]] = [
    {"commands": ""},
    {"commands": "positions"},
    {"commands": "positions", "circle": True},
    {"commands": "states", "circle": True},
]


def distance(drone: DroneHover, hover: Hover) -> float:
    """Return the distance of a trim from the truth [m]."""
    return math.dist(drone.trim, hover.trim)


def test_trims_are_within_their_errors_in_19_of_20_seeds() -> None:
    """So are lags and thrust factors, with and without commands, at rest and in motion."""
    within = {"trim": 0, "thrust": 0, "lag": 0}
    for seed in range(20):
        hover = random_hover(np.random.default_rng(seed), **CASES[seed % 4])
        drone = calibrate_hover(flown({"cf2": hover}, seed), **GAINS).drones["cf2"]
        within["trim"] += distance(drone, hover) < COVERED * drone.trim_error
        off = abs(drone.thrust_factor - hover.thrust_factor)
        within["thrust"] += off < 2.0 * drone.thrust_factor_error
        within["lag"] += not hover.circle or (
            abs(drone.lag - drone.expected_lag) < 2.0 * drone.lag_error
        )
        assert drone.tilt_deg == pytest.approx(hover.tilt_deg, abs=1.5)
        assert drone.agrees
        assert drone.settled > 10.0
        assert drone.trim_error < 0.02
        known = "commanded" if hover.commands else "above the take-off position"
        assert drone.setpoint == known
    assert min(within.values()) >= 19, within


HOVER = Hover(9.0, math.pi, 0.0, 1.1)

FORMATS: dict[str, tuple[Callable[[Path, RecordedFlight], Path], bool]] = {
    "a.bag": (w.write_crazyswarm, True),
    "logs": (w.write_rich_usd, False),
    "table.csv": (w.write_csv, False),
}


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("commands", ["", "positions"])
def test_hovers_are_calibrated_from_files(name: str, commands: str, tmp_path: Path) -> None:
    """Attitudes, where they are recorded, tell the tilt, and the trim is the same without."""
    flight = flown({"cf2": replace(HOVER, commands=commands)}, 3)
    if name == "logs" and commands:  # Logs hold targets at all times
        track = flight.tracks["cf2"]
        targets = flight.setpoints["cf2"].at(track.t)[0]
        start = np.array([*targets[0, :2], track.positions[0, 2]])
        targets[track.t < 4.0] = start
        own = {x: y for x, y in flight.signals["cf2"].items() if not x.startswith("commanded")}
        flight = replace(flight, setpoints={"cf2": Track(track.t, targets)}, signals={"cf2": own})
    write, has_attitude = FORMATS[name]
    drone = calibrate_hover(write(tmp_path / name, flight), **GAINS).drones["cf2"]
    assert distance(drone, HOVER) < 3.0 * drone.trim_error
    assert math.isfinite(drone.tilt_deg) == has_attitude
    if not has_attitude:
        assert "no attitude is recorded: yaw is taken as 0" in drone.remarks
    if name == "logs":
        assert drone.thrust_factor == pytest.approx(1.1, abs=0.01)


def test_a_sentence_says_what_to_do() -> None:
    drone = calibrate_hover(flown({"cf3": HOVER}, 1, 0.003), **GAINS).drones["cf3"]
    assert drone.sentence.startswith("cf3 is tilted by 9.")
    assert "redefine its rigid body; until then it hovers" in drone.sentence
    assert "from its setpoint, toward +x" in drone.sentence  # The trim points to -x
    level = calibrate_hover(flown({"cf3": replace(HOVER, tilt_deg=0.0)}, 1, 0.003), **GAINS)
    assert "is level at rest and hovers within" in level.drones["cf3"].sentence
    short = calibrate_hover(flown({"cf3": replace(HOVER, seconds=6.0)}, 1), **GAINS)
    assert "s were settled: hover for 10 s" in short.drones["cf3"].sentence
    assert short.drones["cf3"].trim_error > drone.trim_error


def test_a_tilt_that_does_not_explain_a_trim_is_reported() -> None:
    """Such a trim is not written: a bent arm, or wind, does not turn with the body."""
    flight = flown({"cf2": HOVER}, 2)
    turned = flight.signals["cf2"]["attitude"]
    upright = Signal(turned.t, np.tile([0.0, 0.0, 0.0, 1.0], (len(turned.t), 1)))
    own = {"cf2": {**flight.signals["cf2"], "attitude": upright}}
    calibration = calibrate_hover(replace(flight, signals=own), **GAINS)
    assert calibration.drones["cf2"].agrees is False
    assert "its tilt does not explain the trim" in calibration.drones["cf2"].sentence
    assert "trim" not in calibration.quadrotor["cf2"]
    assert calibration.quadrotor["cf2"]["thrust_factor"] == pytest.approx(1.1, abs=0.01)


def test_turned_hovers_tell_bodies_from_the_world() -> None:
    """Trims of bodies turn with yaw; those of a wind do not, and are not written."""
    turned = replace(HOVER, yaw=math.pi / 2.0)
    flights = [flown({"cf2": each}, seed) for seed, each in enumerate((HOVER, turned))]
    body = calibrate_hover(flights, **GAINS).drones["cf2"]
    assert body.fixed_to == "body"
    assert distance(body, HOVER) < 3.0 * body.trim_error
    wind = replace(HOVER, yaw=math.pi / 2.0, toward=math.pi / 2.0)  # Also toward -x of the world
    flights[1] = flown({"cf2": wind}, 1)
    world = calibrate_hover(flights, **GAINS)
    assert world.drones["cf2"].fixed_to == "world"
    assert "trim" not in world.quadrotor["cf2"]


def test_trims_that_changed_are_refused() -> None:
    flights = [flown({"cf2": x}, 1) for x in (HOVER, replace(HOVER, tilt_deg=4.0))]
    with pytest.raises(ho.InputError, match=r"trim of cf2 = .*rigid body redefined between them"):
        calibrate_hover(flights, **GAINS)
    again = [flown({"cf2": HOVER}, seed) for seed in (1, 2)]
    both = calibrate_hover(again, **GAINS).drones["cf2"]
    assert both.settled > 20.0
    assert distance(both, HOVER) < 3.0 * both.trim_error


def test_motion_tells_the_trim_by_the_gains() -> None:
    """A flight that never rests tells the trim if mass and gains are known."""
    hover = replace(HOVER, seconds=0.0, circle=True, commands="positions")
    flight = flown({"cf2": hover}, 5, 0.01)
    drone = calibrate_hover(flight, **GAINS).drones["cf2"]
    assert drone.setpoint == "commanded, in motion"
    assert distance(drone, hover) < 2.0 * drone.trim_error
    assert drone.settled == 0.0
    unknown = calibrate_hover(flight).drones["cf2"]
    assert math.isnan(unknown.trim[0])
    assert unknown.lag == pytest.approx(KD / KP, abs=0.5)


def test_hovers_without_a_set_point_are_refused() -> None:
    flight = flown({"cf2": HOVER}, 1)
    track = flight.tracks["cf2"]
    late = Track(track.t[400:700], track.positions[400:700])
    with pytest.raises(FileError, match="its setpoint is unknown; record commands, or record from"):
        calibrate_hover(replace(flight, tracks={"cf2": late}))
    ground = Track(track.t[:80], track.positions[:80])
    with pytest.raises(FileError, match="no drone of cf2 is at rest in flight"):
        calibrate_hover(replace(flight, tracks={"cf2": ground}))
    with pytest.raises(ho.InputError, match="names = 'cf9': must be of cf2"):
        calibrate_hover(flight, names="cf9=q0")


def test_the_command_writes_quadrotors(tmp_path: Path) -> None:
    hovers = {"cf2": HOVER, "cf3": replace(HOVER, tilt_deg=5.0, toward=1.0)}
    bag = w.write_crazyswarm(tmp_path / "hover.bag", flown(hovers, 1))
    file = tmp_path / "drones.yaml"
    values = (f"mass={MASS}", f"kp={KP}", f"kd={KD}")
    options = [word for value in values for word in ("--set", value)]
    options += ["--names", "cf2=q0,cf3=r0"]
    result = CliRunner().invoke(main, ["calibrate", str(bag), *options, "-o", str(file), "--json"])
    assert result.exit_code == 0, result.output
    drones = json.loads(result.stdout)["drones"]
    assert set(drones) == {"q0", "r0"}
    assert drones["q0"]["trim"] == pytest.approx(HOVER.trim.tolist(), abs=0.04)
    assert drones["q0"]["settled"] > 10.0
    written = YAML(typ="safe").load(file)["quadrotor"]
    assert written["q0"]["trim"] == pytest.approx(drones["q0"]["trim"], abs=1e-4)
    assert set(written["r0"]["tracking"]) == {"level", "height"}
