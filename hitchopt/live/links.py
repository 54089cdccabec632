"""Links of a flight: the operator's keys, and fleets that receive setpoints.

JSON and MAVLink are sent by UDP, setpoints of Crazyflies by crazyflie_py. Accelerations for
controllers without cable model are ``a - F / m`` with the cable's force F.
"""

from __future__ import annotations

import json
import math
import os
import select
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from hitchopt.drones.controllers import CONTROLLERS
from hitchopt.drones.firmware import Parameters
from hitchopt.errors import InputError, UnsupportedError, optional_module
from hitchopt.exports.firmware import describe_differences
from hitchopt.exports.formats.crazyflie import LANDED
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.live.fly import FleetSetpoints
from hitchopt.motion.states import Attitudes, attitudes
from hitchopt.values import MAX_COORDINATE, Array

Address = tuple[str, int]

FORMAT = "hitchopt-setpoint/1"
MAX_DATAGRAM = 65536  # maximum size of a datagram [B]
MAX_DATAGRAMS = 1000  # maximum number of datagrams read per tick, so that floods cannot block it
OWN_SYSTEM = 245  # MAVLink system of this sender, above usual fleets and below ground stations
HEARTBEAT_PERIOD = 1.0  # autopilots consider a sender lost after some seconds [s]
SETPOINT_VALIDITY = 500  # validity of a Crazyflie's last setpoint, which its firmware ignores [ms]
LANDING_TIME = 1.0  # least time of the firmware's landing [s]
LANDING_SPEED = 0.4  # mean speed of the firmware's landing [m/s]

LANDINGS = 2
"""Number of landing commands sent to Crazyflies. A setpoint that a drone receives after the command
takes control from its high-level commander, and half a second later the firmware stops the
motors: a second command lands it."""

LANDING_PERIOD = 0.2  # Time between these commands [s]

# Commands by key; ``toggle`` is pause or resume, ``quit`` ends a flight before its start. Signals
# add ``end``, which is land or quit
KEYS = {word[0]: word for word in ("pause", "resume", "back", "abort", "land", "quit")}
KEYS[" "] = "toggle"
KEYS_HELP = "space pause/resume, b back, a abort, l land, q quit before the start"
KEYS_HELP += ", x2 and Enter: robot 2 is lost"
LOSE = "x"  # Key that begins the name of a lost robot, which Enter ends


class Operator:
    """An operator who presses keys, read from standard input without blocking.

    The operator is disconnected if there is no input, or it has ended.
    """

    def __init__(self) -> None:
        self._pending: list[str] = []
        self._lost: str | None = None  # what is typed of a lost robot's name
        try:
            self._input: int | None = sys.stdin.fileno()
        except (AttributeError, ValueError, OSError):  # closed, or replaced by an object
            self._input = None

    def add(self, command: str) -> None:
        """Add a command without a key, for signals."""
        self._pending.append(command)

    def commands(self) -> tuple[list[str], bool]:
        """Return the commands since the last call, and whether the operator is connected."""
        commands = self._pending
        self._pending = []
        if self._input is not None and select.select([self._input], [], [], 0.0)[0]:
            data = b""
            with suppress(OSError):  # the terminal was closed
                data = os.read(self._input, 1024)
            for key in data.decode("utf-8", "ignore"):
                commands += self._typed(key)
            self._input = self._input if data else None
        return commands, self._input is not None

    def _typed(self, key: str) -> list[str]:
        """Return the command that a key completes, if any."""
        if self._lost is None:
            self._lost = "" if key.lower() == LOSE else None
            return [KEYS[key.lower()]] if key.lower() in KEYS else []
        if key not in "\r\n":
            self._lost += key
            return []
        robot = self._lost.strip()
        self._lost = None
        return [f"lose {robot}"] if robot else []

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Receive keys immediately and without echo within the context."""
        descriptor = self._input
        if descriptor is None or not sys.stdin.isatty():
            yield
            return
        import termios
        import tty

        settings = termios.tcgetattr(descriptor)
        tty.setcbreak(descriptor)
        try:
            yield
        finally:
            with suppress(termios.error):  # the terminal may be closed
                termios.tcsetattr(descriptor, termios.TCSADRAIN, settings)


def address(key: str, text: str) -> Address:
    """Return the numeric address of ``HOST:PORT``."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 65536:
        raise InputError(key, text, "HOST:PORT", "such as 127.0.0.1:14540")
    try:
        return socket.gethostbyname(host), int(port)
    except OSError as error:
        raise InputError(key, text, "a known host", f"write its address ({error})") from None


def _attitudes(targets: FleetSetpoints, frame: ReferenceFrame) -> Attitudes:
    """Return attitudes and body rates of the thrusts in a frame."""
    thrusts, thrust_rates = frame.vectors(targets.thrusts), frame.vectors(targets.thrust_rates)
    return attitudes(thrusts, thrust_rates, frame.heading)


class DatagramOutlet(ABC):
    """A fleet connected by UDP; messages of other hosts are ignored.

    Each drone listens at its own address, or all at that of a router. Setpoints are sent from the
    address ``listen``, where measurements arrive; port 0 is any free one.
    """

    controllers: tuple[str, ...] = CONTROLLERS

    def __init__(
        self,
        names: Sequence[str],
        addresses: Sequence[Address],
        frame: ReferenceFrame,
        listen: Address,
    ) -> None:
        self._names = tuple(names)
        self._addresses = tuple(addresses)
        self._frame = frame
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(listen)
        except OSError as error:
            self._socket.close()
            reason = f"cannot listen on {listen[0]}:{listen[1]}: {error.strerror or error}"
            raise UnsupportedError(reason) from None

    @abstractmethod
    def _parsed(self, data: bytes) -> Iterator[tuple[object, Array]]:
        """Yield the names and positions in the frame that a datagram contains."""

    def _send(self, data: bytes, to: Address) -> None:
        """Send a datagram; network errors are ignored."""
        with suppress(OSError):
            self._socket.sendto(data, to)

    def measured(self) -> dict[str, Array]:
        """Return measured positions (3,) [m] in the plan's axes, by drone names."""
        hosts = {host for host, _ in self._addresses}
        positions: dict[str, Array] = {}
        for _ in range(MAX_DATAGRAMS):
            try:
                data, (host, _) = self._socket.recvfrom(MAX_DATAGRAM)
            except BlockingIOError:
                break
            except OSError:  # a report that a port is closed
                continue
            for name, point in self._parsed(data) if host in hosts else ():
                if name in self._names and point.shape == (3,) and np.all(np.isfinite(point)):
                    positions[str(name)] = self._frame.planned(point)
        return positions

    def arm(self) -> None:  # noqa: B027
        """Leave arming to the pilot."""

    def close(self, *, landed: bool) -> None:  # noqa: ARG002
        """Close the socket; autopilots leave offboard mode by their own failsafe."""
        self._socket.close()


class JsonOutlet(DatagramOutlet):
    """A fleet that receives JSON, one datagram per drone and time.

    A receiver replies to the sender with measurements ``{"drone": "q0", "position": [x, y, z]}`` in
    the axes of the setpoints (east-north-up).
    """

    _number = 0

    def send(self, targets: FleetSetpoints, now: float) -> None:
        """Send each drone its setpoint."""
        frame = self._frame
        at = targets.setpoints
        attitude = _attitudes(targets, self._frame)
        rows = {
            "position": frame.points(at.positions),
            "velocity": frame.vectors(at.velocities),
            "acceleration": frame.vectors(at.accelerations),
            "jerk": frame.vectors(at.jerks),
            "feed_forward": frame.vectors(targets.feed_forward),
            "quaternion": attitude.quaternions,
            "body_rates": attitude.body_rates,
        }
        lists = {key: values.tolist() for key, values in rows.items()}
        head = {
            "format": FORMAT,
            "number": self._number,
            "time": now,
            "plan_time": at.time,
            "clock_rate": at.rate,
            "yaw": frame.heading,
        }
        for i, (name, to) in enumerate(zip(self._names, self._addresses, strict=True)):
            row = {key: values[i] for key, values in lists.items()}
            self._send(json.dumps({**head, "drone": name, **row}).encode(), to)
        self._number += 1

    def _parsed(self, data: bytes) -> Iterator[tuple[object, Array]]:
        with suppress(ValueError, RecursionError, AttributeError):  # not JSON, or no object
            message = json.loads(data)
            position = message.get("position")
            if isinstance(position, list) and all(
                type(x) in (int, float) and abs(x) <= MAX_COORDINATE for x in position
            ):
                yield message.get("drone"), np.array(position, dtype=np.float64)


class MavlinkOutlet(DatagramOutlet):
    """A fleet of autopilots in offboard mode, whose north-east-down axes share one origin.

    Drone ``i`` of the plan is system ``i + 1``. SET_POSITION_TARGET_LOCAL_NED sets position,
    velocity, acceleration and yaw; LOCAL_POSITION_NED has measurements. Raises UnsupportedError
    if pymavlink is not installed.
    """

    controllers = ("px4",)

    def __init__(self, *fleet: Any) -> None:
        common = "pymavlink.dialects.v20.common"
        self._mavlink: Any = optional_module(common, "MAVLink needs", "fly")
        super().__init__(*fleet)
        self._sender = self._mavlink.MAVLink(None, srcSystem=OWN_SYSTEM)
        self._start: float | None = None
        self._last_heartbeat = -math.inf

    def send(self, targets: FleetSetpoints, now: float) -> None:
        """Send each autopilot its setpoint, and periodic heartbeats."""
        frame, at, link = self._frame, targets.setpoints, self._mavlink
        self._start = now if self._start is None else self._start
        if now - self._last_heartbeat >= HEARTBEAT_PERIOD:
            self._last_heartbeat = now
            kind = (link.MAV_TYPE_ONBOARD_CONTROLLER, link.MAV_AUTOPILOT_INVALID)
            heartbeat = self._sender.heartbeat_encode(*kind, 0, 0, link.MAV_STATE_ACTIVE)
            for to in dict.fromkeys(self._addresses):
                self._send(heartbeat.pack(self._sender), to)
        velocities, forward = frame.vectors(at.velocities), frame.vectors(targets.feed_forward)
        rows = np.concatenate([frame.points(at.positions), velocities, forward], axis=-1).tolist()
        boot = int(1e3 * (now - self._start)) % 2**32
        axes = (link.MAV_FRAME_LOCAL_NED, link.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE)
        for i, row in enumerate(rows):
            message = self._sender.set_position_target_local_ned_encode(
                boot, i + 1, link.MAV_COMP_ID_AUTOPILOT1, *axes, *row, frame.heading, 0.0
            )
            self._send(message.pack(self._sender), self._addresses[i])

    def _parsed(self, data: bytes) -> Iterator[tuple[object, Array]]:
        parser = self._mavlink.MAVLink(None)  # a new one, so that damage ends with a datagram
        parser.robust_parsing = True
        for message in parser.parse_buffer(data) or []:
            index = message.get_srcSystem() - 1
            if message.get_type() == "LOCAL_POSITION_NED" and index in range(len(self._names)):
                yield self._names[index], np.array([message.x, message.y, message.z])


class CrazyflieOutlet:
    """A fleet of Crazyflies connected by crazyflie_py, the Python client of Crazyswarm2.

    The fleet's world is east-north-up. Measurements are the poses of ``/NAME/pose``, if the fleet's
    configuration logs them.

    Raises
    ------
    InputError: an unknown robot, or a turned frame: ``cmdFullState`` sends yaw as a roll.
    UnsupportedError: crazyflie_py is missing, or drones have other parameters than the plan; the
        server reads them when it connects.
    """

    controllers = ("mellinger", "lee")  # those that add streamed accelerations

    def __init__(
        self,
        names: Sequence[str],
        robots: Sequence[str],
        frame: ReferenceFrame,
        parameters: Mapping[str, Parameters],
    ) -> None:
        if frame.heading != 0.0:
            bound = "0 with crazyflie: crazyflie_py's cmdFullState sends yaw as a roll"
            remedy = "turn polygons and starts in the problem, or upload: hitchopt export --yaw-deg"
            raise InputError("yaw_deg", round(math.degrees(frame.heading), 9), bound, remedy)
        try:
            rclpy, client = import_module("rclpy"), import_module("crazyflie_py")
            pose = import_module("geometry_msgs.msg").PoseStamped
        except ImportError as error:
            remedy = "source the setup of a ROS 2 workspace with Crazyswarm2 first"
            raise UnsupportedError(f"Crazyflies need crazyflie_py ({error}); {remedy}") from None
        self._node = client.Crazyswarm().allcfs
        self._frame = frame
        fleet = self._node.crazyfliesByName
        for robot in robots:
            if robot not in fleet:
                raise InputError("fleet", robot, f"one of {', '.join(fleet)}", "name it in fleet=")
        self._robots = [fleet[robot] for robot in robots]
        self._set_parameters([parameters[name] for name in names], robots)
        self._spin_once = partial(rclpy.spin_once, self._node, timeout_sec=0.0)
        self._positions: dict[str, Array] = {}
        self._heights = np.zeros(len(self._robots))  # of the last setpoints [m]
        for name, robot in zip(names, robots, strict=True):
            callback = partial(self._receive, name)
            self._node.create_subscription(pose, f"/{robot}/pose", callback, 10)

    def _set_parameters(self, parameters: Sequence[Parameters], names: Sequence[str]) -> None:
        """Verify the parameters of all robots, and set them again.

        A launch reads the robots' parameters before it writes those of its own file.
        """
        errors = []
        for name, robot, expected in zip(names, self._robots, parameters, strict=True):

            def value_of(group: str, key: str, robot: Any = robot) -> object:
                return robot.getParam(f"{group}.{key}")  # as the server has read it

            if differences := describe_differences(expected, value_of):
                errors.append(f"{name}: {differences}")
        if errors:
            errors.append(
                "launch twice with crazyflies.yaml of an export and query_all_values_on_connect: "
                "the first launch writes the parameters, the second reads them back"
            )
            raise UnsupportedError("\n".join(errors))
        for robot, groups in zip(self._robots, parameters, strict=True):
            for group, values in groups.items():
                for key, value in values.items():
                    robot.setParam(f"{group}.{key}", value)

    def _receive(self, name: str, message: Any) -> None:
        position = message.pose.position
        point = np.array([position.x, position.y, position.z])
        if np.all(np.isfinite(point)):
            self._positions[name] = self._frame.planned(point)

    def send(self, targets: FleetSetpoints, now: float) -> None:  # noqa: ARG002
        """Send each drone its full state."""
        frame, at = self._frame, targets.setpoints
        vectors = at.velocities, targets.feed_forward
        rows = [frame.points(at.positions), *map(frame.vectors, vectors)]
        self._heights = rows[0][:, 2]
        rates = _attitudes(targets, frame).body_rates.tolist()
        for robot, row, rate in zip(self._robots, np.stack(rows, 1).tolist(), rates, strict=True):
            robot.cmdFullState(*row, frame.heading, rate)

    def measured(self) -> dict[str, Array]:
        """Return the received positions (3,) [m] in the plan's axes, by drone names."""
        for _ in range(4 * len(self._robots)):
            self._spin_once()
        positions = self._positions
        self._positions = {}
        return positions

    def arm(self) -> None:
        """Arm the drones whose client supports it; the others need no arming."""
        for robot in self._robots:
            if hasattr(robot, "arm"):
                robot.arm(True)

    def close(self, *, landed: bool) -> None:
        """Return control to the drones' high-level commander, which lands them.

        Without a command it would immediately stop the motors of drones in the air. Commands are
        repeated, since setpoints may still be on their way.
        """
        for attempt in range(LANDINGS):
            if attempt:
                time.sleep(LANDING_PERIOD)
            for robot, height in zip(self._robots, self._heights.tolist(), strict=True):
                robot.notifySetpointsStop(SETPOINT_VALIDITY)
                if landed or height > LANDED:
                    robot.land(LANDED, max(LANDING_TIME, (height - LANDED) / LANDING_SPEED))
            self._spin_once()
