"""Messages to receivers with the real message definitions, and measurements from them."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock, call

import numpy as np
import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import common as mavlink

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import UnsupportedError
from hitchopt.exports.firmware import team_parameters
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.live.fly import CommandedPlan, FleetSetpoints
from hitchopt.live.links import CrazyflieOutlet, JsonOutlet, MavlinkOutlet, Operator, address
from tests.helpers.plans import planned

HOME = "127.0.0.1"
PLACE = (3.0, -2.0, 0.5), 0.7
"""The plan's origin [m] and yaw [rad] for the drones."""


@contextmanager
def receivers(count: int) -> Iterator[tuple[list[socket.socket], list[tuple[str, int]]]]:
    with ExitStack() as stack:
        found = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
        for each in found:
            stack.enter_context(each).bind((HOME, 0))
            each.settimeout(5.0)
        yield found, [each.getsockname() for each in found]


@cache
def moving() -> FleetSetpoints:
    course = CommandedPlan(planned("triangle").flight, {})
    course.obey("resume")
    return course.step(0.7)


RETUNED = ho.Quadrotor(controller="mellinger", gains={"kp": 4.75, "kd": 1.32, "ki": 0})
NAMES = "q0", "r0", "q1", "r1", "q2", "r2"


def test_json_arrives_and_answers_are_read() -> None:
    flown, frame = moving(), ReferenceFrame("enu", *PLACE)
    places = frame.points(flown.setpoints.positions)
    with receivers(6) as (found, addresses):
        outlet = JsonOutlet(NAMES, addresses, frame, (HOME, 0))
        outlet.send(flown, 12.5)
        for i, (name, each) in enumerate(zip(NAMES, found, strict=True)):
            data, sender = each.recvfrom(65536)
            got = json.loads(data)
            assert (got["drone"], got["number"], got["time"]) == (name, 0, 12.5)
            np.testing.assert_allclose(got["position"], places[i], atol=1e-12)
            thrust = np.array(got["feed_forward"]) + [0.0, 0.0, 9.80665]
            w, x, y, z = got["quaternion"]
            up = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
            np.testing.assert_allclose(up, thrust / np.linalg.norm(thrust), atol=1e-3)
            place = [*got["position"][:2], None] if i else got["position"]
            own = {"drone": name, "position": place}
            other = b'{"drone": "q9", "position": [1, 2, 3]}'
            for answer in (b"{", b"[]", other, json.dumps(own).encode()):
                each.sendto(answer, sender)
        measured = outlet.measured()
        assert set(measured) == {"q0"}
        np.testing.assert_allclose(measured["q0"], flown.setpoints.positions[0], atol=1e-12)
        outlet.close(landed=True)


def test_mavlink_is_understood_by_its_own_parser() -> None:
    flown, frame = moving(), ReferenceFrame("ned", *PLACE)
    east, north, up = ReferenceFrame("enu", *PLACE).points(flown.setpoints.positions).T
    forward = frame.vectors(flown.feed_forward)
    with receivers(1) as ([router], addresses):
        outlet = MavlinkOutlet(NAMES, addresses * 6, frame, (HOME, 0))
        outlet.send(flown, 50.0)
        outlet.send(flown, 50.25)
        parser, got = mavlink.MAVLink(None), []
        for _ in range(13):
            data, sender = router.recvfrom(65536)
            got += parser.parse_buffer(data)
        beat, *targets = got
        assert (beat.get_type(), beat.type) == ("HEARTBEAT", mavlink.MAV_TYPE_ONBOARD_CONTROLLER)
        assert [each.target_system for each in targets] == [*range(1, 7)] * 2
        assert {each.time_boot_ms for each in targets[6:]} == {250}
        for i, each in enumerate(targets[:6]):
            assert each.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
            assert each.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
            assert each.type_mask == mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
            np.testing.assert_allclose([each.x, each.y, each.z], [north[i], east[i], -up[i]], 1e-6)
            np.testing.assert_allclose([each.afx, each.afy, each.afz], forward[i], atol=1e-6)
            assert each.yaw == pytest.approx(np.pi / 2 - PLACE[1], abs=1e-6)

        def answered(system: int) -> bytes:
            vehicle = mavlink.MAVLink(None, srcSystem=system)
            place = north[2], east[2], -up[2], 0.0, 0.0, 0.0
            return bytes(vehicle.local_position_ned_encode(7, *place).pack(vehicle))

        for data in (b"\xfd\x00nonsense", answered(3)[:9], b"junk" + answered(3), answered(77)):
            router.sendto(data, sender)
        measured = outlet.measured()
        assert set(measured) == {"q1"}
        np.testing.assert_allclose(measured["q1"], flown.setpoints.positions[2], atol=1e-6)
        outlet.close(landed=False)


ROBOTS = [f"cf{i}" for i in range(6)]
FRAME = ReferenceFrame("enu", PLACE[0])


def wanted_parameters() -> dict[str, dict[str, dict[str, float]]]:
    return team_parameters(replace(planned("triangle").motion.team, quadrotor=(RETUNED,) * 3))


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Mock:
    """The server of crazyflie_py's ``Crazyswarm``; drones hold the wanted parameters."""
    node = Mock(crazyfliesByName={name: Mock() for name in ROBOTS})
    groups = wanted_parameters()["q0"].items()
    node.held = {f"{g}.{k}": x for g, named in groups for k, x in named.items()}
    for robot in node.crazyfliesByName.values():
        robot.getParam.side_effect = node.held.get

    def spin_once(spun: Mock, timeout_sec: float) -> None:
        assert (spun, timeout_sec) == (node, 0.0)
        position = FRAME.points(moving().setpoints.positions)[1].tolist()
        place = SimpleNamespace(**dict(zip("xyz", position, strict=True)))
        heard = node.create_subscription.call_args_list[1].args[2]
        heard(SimpleNamespace(pose=SimpleNamespace(position=place)))

    client = SimpleNamespace(Crazyswarm=lambda: SimpleNamespace(allcfs=node))
    poses = SimpleNamespace(PoseStamped=SimpleNamespace)
    ros = {"rclpy": SimpleNamespace(spin_once=spin_once), "geometry_msgs.msg": poses}
    for name, module in (ros | {"crazyflie_py": client}).items():
        monkeypatch.setitem(sys.modules, name, module)
    return node


def test_crazyflies_receive_full_states(node: Mock) -> None:
    flown, robots = moving(), node.crazyfliesByName.values()
    vectors = flown.setpoints.velocities, flown.feed_forward
    rows = [FRAME.points(flown.setpoints.positions), *map(FRAME.vectors, vectors)]
    outlet = CrazyflieOutlet(NAMES, ROBOTS, FRAME, wanted_parameters())
    for robot in robots:
        assert {each.args for each in robot.setParam.call_args_list} == set(node.held.items())
        assert not robot.arm.called
    outlet.send(flown, 1.0)
    for i, robot in enumerate(robots):
        *found, yaw, omega = robot.cmdFullState.call_args.args
        np.testing.assert_allclose(found, [each[i] for each in rows])
        assert yaw == 0.0  # cmdFullState turns any other one into a roll
        assert len(omega) == 3
        assert all(type(x) is float for part in (*found, omega) for x in part)
    measured = outlet.measured()
    assert set(measured) == {"r0"}
    np.testing.assert_allclose(measured["r0"], flown.setpoints.positions[1], atol=1e-12)
    outlet.arm()
    assert all(robot.mock_calls[-1] == call.arm(True) for robot in robots)


@pytest.mark.parametrize("landed", [True, False])
@pytest.mark.parametrize("height", [0.02, 0.2, 1.5])
def test_crazyflies_land_when_the_stream_ends(node: Mock, height: float, *, landed: bool) -> None:
    """Also after an exception, at 0.4 m/s down; those that stand before the start stay there.

    A setpoint that arrives after the first command to land takes control back, so all are repeated.
    """
    outlet = CrazyflieOutlet(NAMES, ROBOTS, FRAME, wanted_parameters())
    setpoints = moving().setpoints
    level = setpoints.positions * [1.0, 1.0, 0.0] + [0.0, 0.0, height - PLACE[0][2]]
    outlet.send(replace(moving(), setpoints=replace(setpoints, positions=level)), 1.0)
    robot = node.crazyfliesByName["cf3"]
    robot.reset_mock()
    outlet.close(landed=landed)
    notified = call.notifySetpointsStop(500)  # the firmware may ignore these milliseconds
    seconds = pytest.approx(max(1.0, (height - 0.04) / 0.4))
    landing = [call.land(0.04, seconds)] if landed or height > 0.04 else []
    assert robot.mock_calls == 2 * [notified, *landing]


def test_crazyflies_that_would_fly_otherwise_are_refused(node: Mock) -> None:
    wanted = wanted_parameters()
    with pytest.raises(ho.InputError, match="fleet = 'cf9'"):
        CrazyflieOutlet(NAMES, ["cf9"] * 6, FRAME, wanted)
    with pytest.raises(ho.InputError, match=r"yaw_deg = 40.0: (.|\n)*sends yaw as a roll"):
        CrazyflieOutlet(NAMES, ROBOTS, ReferenceFrame("enu", PLACE[0], np.radians(40.0)), wanted)
    node.held["ctrlMel.kp_xy"] = 0.4
    del node.held["kalman.pNAcc_z"]
    words = r"cf4: kalman.pNAcc_z is missing, not 20.0, ctrlMel.kp_xy is 0.4, not 4.75(.|\n)*twice"
    with pytest.raises(UnsupportedError, match=words):
        CrazyflieOutlet(NAMES, ROBOTS, FRAME, wanted)
    assert not node.crazyfliesByName["cf4"].setParam.called


def test_keys_are_read_until_the_terminal_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    far, near = pty.openpty()
    with os.fdopen(near) as terminal, monkeypatch.context() as patched:
        patched.setattr(sys, "stdin", terminal)
        operator = Operator()
        with operator.attached():
            assert operator.commands() == ([], True)
            os.write(far, b"B ?")
            operator.add("end")
            assert operator.commands() == (["end", "back", "toggle"], True)
            os.close(far)
            assert operator.commands() == ([], False)
            assert operator.commands() == ([], False)
    monkeypatch.setattr(sys, "stdin", None)
    assert Operator().commands() == ([], False)


def test_invalid_arguments_and_missing_libraries_are_refused() -> None:
    for text in ("here", "127.0.0.1:x", ":5", "127.0.0.1:70000"):
        with pytest.raises(ho.InputError, match="--to"):
            address("--to", text)
    with pytest.raises(UnsupportedError, match="ROS 2 workspace"):
        CrazyflieOutlet(NAMES, NAMES, ReferenceFrame(), {})
    with pytest.raises(UnsupportedError, match="cannot listen on"):
        JsonOutlet(NAMES, [], ReferenceFrame(), ("192.0.2.1", 0))


def test_the_command_streams_the_start_and_ends_without_an_operator(tmp_path: Path) -> None:
    planned("triangle").save(tmp_path / "plan")
    runner = CliRunner()
    with receivers(1) as ([receiver], [(host, port)]):
        options = ["--over", "json", "--to", f"{host}:{port}", "--patience", "0.1"]
        done = runner.invoke(main, ["fly", str(tmp_path / "plan"), *options])
        assert done.exit_code == 3, done.output
        assert "at rest at the plan's start" in done.output
        assert "no operator is connected" in done.output
        got = json.loads(receiver.recv(65536))
        np.testing.assert_allclose(
            got["position"], planned("triangle").at(0.0).positions[0], atol=1e-9
        )
    wrong = runner.invoke(main, ["fly", str(tmp_path / "plan"), *options, "--to", f"{host}:9"])
    assert wrong.exit_code == 2
    assert "--to = 2: must be given once, or 6 times" in wrong.output


def test_the_command_says_at_once_that_it_needs_signals_of_terminals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows has none: no plan is read, and nothing is sent."""
    monkeypatch.delattr(signal, "SIGHUP")
    (tmp_path / "plan").mkdir()
    done = CliRunner().invoke(main, ["fly", str(tmp_path / "plan"), "--over", "json"])
    assert done.exit_code == 3, done.output
    (line,) = " ".join(done.output.split()).split("error: ")[1:]
    assert line.startswith("fly needs Linux or macOS")


@pytest.mark.parametrize(
    ("over", "name", "known"),
    [("crazyflie", "px4", "mellinger or lee"), ("mavlink", "lee", "px4")],
)
def test_controllers_that_are_not_streamed_to_are_refused(
    over: str, name: str, known: str, tmp_path: Path
) -> None:
    team = ho.Team(3, 3.4, tension=0.2, quadrotor=ho.Quadrotor(controller=name, tracking=0.2))
    ho.solve(ho.Hitch.balanced(team, ho.regular_polygon(3, 1.2), 1.5), ho.Hold(0.5)).save(
        tmp_path / "plan"
    )
    done = CliRunner().invoke(main, ["fly", str(tmp_path / "plan"), "--over", over])
    assert done.exit_code == 2, done.output
    words = f"team.quadrotor.controller = '{name}': must be {known} for --over {over}"
    assert words in " ".join(done.output.split())
