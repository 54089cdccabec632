"""Parameters of firmwares: control laws with them are equal to the team's position loops."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

import hitchopt as ho
from hitchopt.drones.firmware import CONTROLLER_NUMBERS, Parameters
from hitchopt.exports.contents import read_manifest
from hitchopt.exports.firmware import (
    SETTINGS,
    describe_differences,
    px4_team_parameters,
    team_parameters,
)
from tests.helpers.exported_plans import EACH_FORMAT, Array, exported

LEVEL, UPRIGHT = 0, 1
KINDS = st.builds(
    lambda name, mass, lift, stiff, damped, ki: ho.Quadrotor(
        mass,
        9.81 * mass * lift,
        controller=name,
        gains={"kp": [stiff * mass, 0.5 * stiff * mass], "kd": [damped * mass, mass], "ki": ki},
    ),
    st.sampled_from(["mellinger", "lee"]),
    st.floats(0.02, 0.5),
    st.floats(1.3, 3.0),
    st.floats(1.0, 14.0),
    st.floats(1.0, 10.0),
    st.sampled_from([0.0, 0.05]),
)


def of_team(kind: ho.Quadrotor) -> Parameters:
    return team_parameters(ho.Team(3, 2.4, quadrotor=kind))["r1"]


def commanded(parameters: Parameters, offset: Array, slower: Array, summed: Array) -> Array:
    """The force of either law by errors of position and velocity and the former's integral."""
    if mel := parameters.get("ctrlMel"):
        gains = [
            [mel[f"{term}_{axis}"] for axis in ("xy", "xy", "z")] for term in ("kp", "kd", "ki")
        ]
        scale = 1.0
    else:
        lee = parameters["ctrlLee"]
        gains, scale = [[lee[f"Kpos_{t}{axis}"] for axis in "xyz"] for t in "PDI"], lee["mass"]
    force: Array = scale * np.sum(np.array(gains) * [offset, slower, summed], axis=0)
    return force


@given(KINDS)
@settings(max_examples=60, deadline=None)
def test_the_law_answers_errors_as_the_team_s_loop(kind: ho.Quadrotor) -> None:
    parameters, loop = of_team(kind), kind.loop
    assert parameters["stabilizer"] == {"estimator": 2, "controller": CONTROLLER_NUMBERS[loop.name]}
    for term, (level, upright) in enumerate((loop.kp, loop.kd, loop.ki)):
        errors = np.zeros((3, 3))
        errors[term] = [0.1, -0.2, 0.3]
        expected = errors[term] * [level, level, upright]
        np.testing.assert_allclose(commanded(parameters, *errors), expected, rtol=2e-5, atol=1e-9)
    if mel := parameters.get("ctrlMel"):
        for key, axis in (("xy", LEVEL), ("z", UPRIGHT)):
            limit = mel.get(f"i_range_{key}", 0.0) * mel[f"ki_{key}"]
            assert limit == pytest.approx(loop.ki_limit[axis], rel=2e-5)
        # The command that hovers is the weight's share of full thrust.
        hover = mel["massThrust"] * mel["mass"] * 9.81 / 65535.0
        assert hover == pytest.approx(kind.mass * 9.81 / kind.max_thrust, rel=2e-5)


@given(st.floats(0.035, 0.5), st.floats(1.3, 3.0))
@settings(max_examples=40, deadline=None)
def test_drones_of_one_shape_turn_as_the_stock_crazyflie_does(mass: float, lift: float) -> None:
    """Angular acceleration by attitude error, at inertia ~ m^(5/3) and arms ~ m^(1/3)."""
    thrust = 9.81 * mass * lift
    size = mass / 0.0313
    arm, inertia = 0.046 * size ** (1 / 3), 16.57e-6 * size ** (5 / 3)
    found = {
        name: of_team(ho.Quadrotor(mass, thrust, controller=name)) for name in ("mellinger", "lee")
    }
    # Half a command on each of four motors at arm / √2, of a quarter of the thrust at 65535.
    moment = thrust / 65535.0 * arm / (2.0 * math.sqrt(2.0))
    stock = 70000.0 / 132000.0 * 0.046 / (2.0 * math.sqrt(2.0)) / 16.57e-6
    mel, lee = found["mellinger"]["ctrlMel"], found["lee"]["ctrlLee"]
    assert mel["kR_xy"] * moment / inertia == pytest.approx(stock, rel=1e-4)
    assert mel["kw_xy"] / mel["kR_xy"] == pytest.approx(2.0 / 7.0, rel=1e-4)
    assert lee["J_x"] == pytest.approx(inertia, rel=1e-4)
    assert lee["KR_x"] / lee["J_x"] == pytest.approx(0.007 / 16.57e-6, rel=1e-4)


def test_unnamed_controllers_are_left_to_the_pilot() -> None:
    assert CONTROLLER_NUMBERS == {"pid": 1, "mellinger": 2, "lee": 5}  # stabilizer.controller
    filter_alone = {
        "stabilizer": {"estimator": 2, "controller": 2},
        "kalman": {"pNAcc_xy": 20.0, "pNAcc_z": 20.0},
        "locSrv": {"extPosStdDev": 0.001, "extQuatStdDev": 0.01},
    }
    assert of_team(ho.Quadrotor()) == filter_alone
    stated = of_team(ho.Quadrotor(stiffness=3.0))
    named = of_team(
        ho.Quadrotor(
            controller="mellinger", gains={"kp": 3.0, "kd": stated["ctrlMel"]["kd_xy"], "ki": 0}
        )
    )
    assert {**stated, "ctrlMel": None} == {**filter_alone, "ctrlMel": None}
    assert stated["ctrlMel"] == pytest.approx(named["ctrlMel"], rel=1e-5)
    given_later = team_parameters(ho.Team(3, 2.4), 3.0, 1.1)["q0"]["ctrlMel"]
    assert (given_later["kp_z"], given_later["kd_xy"]) == (3.0, 1.1)
    base = of_team(ho.Quadrotor(0.03, 0.6, controller="pid"))["posCtlPid"]["thrustBase"]
    assert base == round(65535 * 0.03 * 9.81 / 0.6)
    assert isinstance(base, int)
    stock = of_team(ho.Quadrotor(0.04, 0.8, controller="mellinger"))["ctrlMel"]
    known = {"kp_xy": 0.4, "kd_xy": 0.2, "ki_xy": 0.05, "i_range_xy": 2.0, "kp_z": 1.25}
    assert known.items() <= stock.items()
    words = describe_differences(
        of_team(ho.Quadrotor()), lambda *names: {"pNAcc_z": 20.0 + 1e-6}.get(names[1])
    )
    assert words.startswith("stabilizer.estimator is missing, not 2, ")
    assert "pNAcc_z" not in words


RANGES = {
    **{"MPC_XY_P": (0.0, 2.0), "MPC_XY_VEL_P_ACC": (1.2, 5.0), "MPC_XY_VEL_I_ACC": (0.0, 60.0)},
    **{"MPC_Z_P": (0.0, 1.5), "MPC_Z_VEL_P_ACC": (2.0, 15.0), "MPC_Z_VEL_I_ACC": (0.2, 3.0)},
}
"""As the sources of PX4 declare them."""


@given(
    st.floats(0.03, 2.0),
    *(st.tuples(st.floats(0.1, most), st.floats(0.1, most)) for most in (40, 9, 9)),
)
@settings(max_examples=60, deadline=None)
def test_px4_gets_gains_within_its_ranges_and_the_loop_follows(
    mass: float, kp: tuple[float, float], kd: tuple[float, float], ki: tuple[float, float]
) -> None:
    gains = {"kp": kp, "kd": kd, "ki": ki}
    kind = ho.Quadrotor(mass, 20.0 * mass, controller="px4", gains=gains)
    found = px4_team_parameters(ho.Team(3, 2.4, quadrotor=kind))["r1"]
    for name, (least, most) in RANGES.items():
        assert least <= found[name] <= most
    for axes, i in (("XY", LEVEL), ("Z", UPRIGHT)):
        p, vp, vi = (found[f"MPC_{axes}_{key}"] for key in ("P", "VEL_P_ACC", "VEL_I_ACC"))
        loop = kind.loop.kp[i], kind.loop.kd[i], kind.loop.ki[i]
        assert mass * np.array([p * vp, vp, vi * p]) == pytest.approx(loop, rel=1e-5)
        stated = kp[i] / kd[i], kd[i] / mass, ki[i] * kd[i] / (kp[i] * mass)
        keys = [f"MPC_{axes}_{key}" for key in ("P", "VEL_P_ACC", "VEL_I_ACC")]
        assert [found[key] for key in keys] == pytest.approx(
            [np.clip(x, *RANGES[key]) for key, x in zip(keys, stated, strict=True)], rel=1e-5
        )


def test_clipped_gains_of_px4_are_reported(tmp_path: Path) -> None:
    """And an integral that is upright alone leaves the tension to the feed-forward."""
    for kp, count in (([1.3, 1.9], 0), (4.75, 1)):
        gains = {"kp": kp, "kd": [0.66, 1.32], "ki": [0, 0.04]}
        plan = plan_of(ho.Quadrotor(controller="px4", gains=gains))
        (part,) = exported(plan.motion, "mavsdk_drone_show", tmp_path)
        clipped = [note for note in part.notes if "clipped" in note]
        assert len(clipped) == count
        assert all("kp [1.32, 1.98], kd [0.66, 1.32]" in note for note in clipped)
        assert (read_manifest(tmp_path) or {})["undetermined_tension"] == []


@pytest.mark.parametrize("gains", [None, {"kp": [0.3, 0.9], "kd": [0.4, 0.7], "ki": [0.1, 0.2]}])
def test_px4_gets_the_gains_that_are_stated(gains: dict[str, Any] | None) -> None:
    kind = ho.Quadrotor(controller="px4", gains=gains)
    found = px4_team_parameters(ho.Team(3, 2.4, quadrotor=kind))["q2"]
    assert {"MPC_ACC_DECOUPLE": 0, "MPC_USE_HTE": 0}.items() <= found.items()
    assert len(found) == (2 if gains is None else 8)
    for axes, i in (("XY", LEVEL), ("Z", UPRIGHT)) if gains else ():
        p, vp, vi = (found[f"MPC_{axes}_{key}"] for key in ("P", "VEL_P_ACC", "VEL_I_ACC"))
        pairs = (kind.loop.kp[i], kind.loop.kd[i], kind.loop.ki[i])
        assert 0.132 * np.array([p * vp, vp, vi * p]) == pytest.approx(pairs, rel=1e-5)


def plan_of(kind: ho.Quadrotor) -> ho.Plan:
    team = ho.Team(3, 2.4, quadrotor=kind)
    return ho.solve(ho.Hitch.balanced(team, ho.regular_polygon(3, 1.0), 1.2), ho.Hold(0.5))


RETUNED = ho.Quadrotor(controller="mellinger", gains={"kp": 4.75, "kd": 1.32, "ki": 0})
PX4 = ho.Quadrotor(controller="px4", tracking=0.2)  # closer than its default: hitches are small
UPLOADED = "crazyswarm2", "compressed"


@pytest.mark.parametrize("name", EACH_FORMAT)
def test_the_manifest_says_how_and_by_whom_a_plan_is_flown(name: str, tmp_path: Path) -> None:
    kind = PX4 if name == "mavsdk_drone_show" else RETUNED
    plan = plan_of(kind)
    uploaded = name in (*UPLOADED, "skybrush")
    exported(plan.motion, name, tmp_path / "named", allow_slack=False)
    exported(plan_of(ho.Quadrotor()).motion, name, tmp_path / "unnamed")
    named, unnamed = (read_manifest(tmp_path / each) or {} for each in ("named", "unnamed"))
    flown = "upload" if uploaded else "" if name in ("gltf", "mjcf") else "stream"
    assert named["flown_by"] == unnamed["flown_by"] == flown
    assert (named["controllers"], unnamed["controllers"]) == ([kind.controller], [])
    if name in (*UPLOADED, "ros2bag"):
        parameters = team_parameters(plan.motion.team)
        assert named["receiver"]["parameters"] == parameters
        if (settings := tmp_path / "named" / SETTINGS).exists():
            robots = YAML(typ="safe").load(settings)["robots"]
            assert {name: robots[name]["firmware_params"] for name in robots} == parameters
        assert settings.exists() == (name != "compressed")
    if name in UPLOADED:
        assert any("set team.quadrotor.controller" in note for note in unnamed["notes"])
        assert any("with cflib" in note for note in named["notes"]) == (name == "compressed")


def test_a_stated_latency_is_stored_and_checked_before_arming(tmp_path: Path) -> None:
    gains = {"kp": 2.24, "kd": 0.9, "ki": 0}
    for kind, latency in ((RETUNED, 20), (replace(RETUNED, gains=gains, latency=0.04), 40)):
        plan_of(kind).save(tmp_path / "plan")
        plan = ho.load(tmp_path / "plan")
        assert plan.motion.team.quadrotor[0] == kind
        plan.export("crazyswarm2", tmp_path / "files")
        for name in ("README.txt", "fly.py"):
            text = (tmp_path / "files" / name).read_text(encoding="utf-8")
            assert f"poses reach drones less than {latency} ms late" in text


REFUSED: list[tuple[str, ho.Quadrotor, dict[str, Any], str]] = [
    (
        "compressed",
        RETUNED,
        {"stiffness": 2.0},
        "stiffness = 2.0: must be omitted with controller mellinger",
    ),
    ("csv", ho.Quadrotor(), {"damping": 2.0}, "omitted for csv without hold_tension=True"),
    (
        "crazyswarm2",
        PX4,
        {},
        "team.quadrotor.controller = 'px4': must be pid, mellinger or lee for crazyswarm2",
    ),
    ("mavsdk_drone_show", RETUNED, {}, "controller = 'mellinger': must be px4 for"),
    ("crazyswarm2", ho.Quadrotor(), {"stiffness": 9.0}, "gains.kp = 9"),
    ("crazyswarm2", ho.Quadrotor(stiffness=9.0), {}, "gains.kp = 9"),
]


@pytest.mark.parametrize(("name", "kind", "options", "words"), REFUSED)
def test_gains_and_controllers_that_a_format_cannot_have_are_refused(
    name: str, kind: ho.Quadrotor, options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ho.InputError) as caught:
        exported(plan_of(kind).motion, name, tmp_path / "files", **options)
    assert words in str(caught.value)
    assert not (tmp_path / "files").exists()
    single = ho.Swarm(2, quadrotor=RETUNED)  # that nothing pulls
    assert set(team_parameters(single)) == {"d0", "d1"}
