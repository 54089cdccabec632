"""Links of a flight: the operator's keys, and fleets that are sent setpoints.

JSON and MAVLink go over UDP, Crazyflies are reached by crazyflie_py. Accelerations for controllers
that know no cable are ``a - F / m`` with the cable's force F.
"""

from __future__ import annotations

import json
import math
import os
import select
import socket
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.exports.firmware import Parameters, describe_differences
from hitchopt.exports.formats.crazyflie import LANDED
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.hitch.flight_controller import CONTROLLERS
from hitchopt.live.fly import FleetSetpoints
from hitchopt.motion.states import Attitudes, attitudes
from hitchopt.values import MAX_COORDINATE, Array

Address = tuple[str, int]

FORMAT = "hitchopt-setpoint/1"
LARGEST = 65536  # size of the largest datagram [B]
MAX_DATAGRAMS = 1000  # datagrams that are read at once: a flood must not stop the stream
OWN_SYSTEM = 245  # this MAVLink sender, beyond usual fleets and below ground stations
BEAT = 1.0  # period of heartbeats: autopilots take a sender for lost after some seconds [s]
VALID = 500  # how long a Crazyflie's last setpoint remains valid when the stream ends [ms]
DOWN = 1.0  # time in which the firmware puts down landed ones [s]

# Commands by key; ``toggle`` is pause or resume, ``quit`` ends what has not left its start. Of
# signals there is ``end`` as well: land, or quit
KEYS = {word[0]: word for word in ("pause", "resume", "back", "abort", "land", "quit")}
KEYS[" "] = "toggle"
KEYS_HELP = "space pause/resume, b back, a abort, l land, q quit before the start"


class Operator:
    """The keys of standard input. A terminal gives each at once within the context, and shows none.

    The operator is not heard of where there is no input, or it has ended.
    """

    def __init__(self) -> None:
        self._added: list[str] = []
        try:
            self._input: int | None = sys.stdin.fileno()
        except (AttributeError, ValueError, OSError):  # closed, or replaced by an object
            self._input = None

    def add(self, command: str) -> None:
        """Give a command as if a key were pressed: signals do."""
        self._added.append(command)

    def commands(self) -> tuple[list[str], bool]:
        """Return the commands since the last call, and whether the operator was heard of."""
        commands, self._added = self._added, []
        if self._input is not None and select.select([self._input], [], [], 0.0)[0]:
            data = b""
            with suppress(OSError):  # the terminal has gone
                data = os.read(self._input, 1024)
            commands += [KEYS[key] for key in data.decode("utf-8", "ignore").lower() if key in KEYS]
            self._input = self._input if data else None
        return commands, self._input is not None

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Have keys at once, as long as the context lasts."""
        number = self._input
        if number is None or not sys.stdin.isatty():
            yield
            return
        import termios
        import tty

        before = termios.tcgetattr(number)
        tty.setcbreak(number)
        try:
            yield
        finally:
            with suppress(termios.error):  # the terminal may have gone
                termios.tcsetattr(number, termios.TCSADRAIN, before)


def address(key: str, text: str) -> Address:
    """Return the numeric address that ``HOST:PORT`` names."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 65536:
        raise InputError(key, text, "HOST:PORT", "such as 127.0.0.1:14540")
    try:
        return socket.gethostbyname(host), int(port)
    except OSError as error:
        raise InputError(key, text, "a known host", f"write its address ({error})") from None


def _turned(targets: FleetSetpoints, frame: ReferenceFrame) -> Attitudes:
    """Return attitudes and body rates of the thrusts in a frame."""
    both = frame.vectors(targets.thrusts), frame.vectors(targets.thrust_rates)
    return attitudes(*both, frame.heading)


class DatagramOutlet(ABC):
    """A fleet behind UDP; answers of hosts that are sent nothing are ignored.

    Each drone listens at its own address, or all at a router's. The stream comes from ``listen``,
    where answers arrive; port 0 is any free one.
    """

    controllers: tuple[str, ...] = CONTROLLERS

    def __init__(
        self,
        names: Sequence[str],
        addresses: Sequence[Address],
        frame: ReferenceFrame,
        listen: Address,
    ) -> None:
        self._names, self._addresses, self._frame = tuple(names), tuple(addresses), frame
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(listen)
        except OSError as error:
            self._socket.close()
            words = f"{listen[0]}:{listen[1]} cannot be listened on: {error.strerror or error}"
            raise UnsupportedError(words) from None

    @abstractmethod
    def _answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        """Yield whose positions a datagram tells, and where they are in the frame."""

    def _send(self, data: bytes, to: Address) -> None:
        """Send a datagram; one that the network does not take is lost like any other."""
        with suppress(OSError):
            self._socket.sendto(data, to)

    def measured(self) -> dict[str, Array]:
        """Return measured positions (3,) [m] in the plan's axes, by the drones' names."""
        hosts = {host for host, _ in self._addresses}
        places: dict[str, Array] = {}
        for _ in range(MAX_DATAGRAMS):
            try:
                data, (host, _) = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                break
            except OSError:  # an answer that a port is closed
                continue
            for name, point in self._answers(data) if host in hosts else ():
                if name in self._names and point.shape == (3,) and np.all(np.isfinite(point)):
                    places[str(name)] = self._frame.planned(point)
        return places

    def arm(self) -> None:  # noqa: B027
        """Leave arming to the pilot."""

    def close(self, *, landed: bool) -> None:  # noqa: ARG002
        """Close the socket; autopilots leave offboard mode as they are set to."""
        self._socket.close()


class JsonOutlet(DatagramOutlet):
    """A fleet that reads JSON, one datagram for every drone and time.

    A receiver answers each datagram's sender with ``{"drone": "q0", "position": [x, y, z]}``,
    measured, in the axes of the setpoints (east-north-up).
    """

    _number = 0

    def send(self, targets: FleetSetpoints, now: float) -> None:
        """Send every drone its setpoint."""
        frame, at, turned = self._frame, targets.setpoints, _turned(targets, self._frame)
        rows = {
            "position": frame.points(at.positions),
            "velocity": frame.vectors(at.velocities),
            "acceleration": frame.vectors(at.accelerations),
            "jerk": frame.vectors(at.jerks),
            "feed_forward": frame.vectors(targets.feed_forward),
            "quaternion": turned.quaternions,
            "body_rates": turned.body_rates,
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
            own = {key: values[i] for key, values in lists.items()}
            self._send(json.dumps({**head, "drone": name, **own}).encode(), to)
        self._number += 1

    def _answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        with suppress(ValueError, RecursionError, AttributeError):  # not JSON, or no object
            answer = json.loads(data)
            place = answer.get("position")
            if isinstance(place, list) and all(
                type(x) in (int, float) and abs(x) <= MAX_COORDINATE for x in place
            ):
                yield answer.get("drone"), np.array(place, dtype=np.float64)


class MavlinkOutlet(DatagramOutlet):
    """A fleet of autopilots in offboard mode, whose north-east-down axes share one origin.

    Drone ``i`` of the plan is system ``i + 1``. SET_POSITION_TARGET_LOCAL_NED sets position,
    velocity, acceleration and yaw; they answer with LOCAL_POSITION_NED. Without pymavlink
    UnsupportedError is raised.
    """

    controllers = ("px4",)

    def __init__(self, *fleet: Any) -> None:
        try:
            self._mavlink: Any = import_module("pymavlink.dialects.v20.common")
        except ImportError as error:
            words = f"MAVLink needs the package pymavlink ({error}); pip install 'hitchopt[fly]'"
            raise UnsupportedError(words) from None
        super().__init__(*fleet)
        self._sender = self._mavlink.MAVLink(None, srcSystem=OWN_SYSTEM)
        self._begun: float | None = None
        self._beaten = -math.inf

    def send(self, targets: FleetSetpoints, now: float) -> None:
        """Send every autopilot its setpoint, and a heartbeat now and then."""
        frame, at, link = self._frame, targets.setpoints, self._mavlink
        self._begun = now if self._begun is None else self._begun
        if now - self._beaten >= BEAT:
            self._beaten = now
            kind = (link.MAV_TYPE_ONBOARD_CONTROLLER, link.MAV_AUTOPILOT_INVALID)
            beat = self._sender.heartbeat_encode(*kind, 0, 0, link.MAV_STATE_ACTIVE)
            for to in dict.fromkeys(self._addresses):
                self._send(beat.pack(self._sender), to)
        velocities, forward = frame.vectors(at.velocities), frame.vectors(targets.feed_forward)
        rows = np.concatenate([frame.points(at.positions), velocities, forward], axis=-1).tolist()
        boot = int(1e3 * (now - self._begun)) % 2**32
        axes = (link.MAV_FRAME_LOCAL_NED, link.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE)
        for i, row in enumerate(rows):
            message = self._sender.set_position_target_local_ned_encode(
                boot, i + 1, link.MAV_COMP_ID_AUTOPILOT1, *axes, *row, frame.heading, 0.0
            )
            self._send(message.pack(self._sender), self._addresses[i])

    def _answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        parser = self._mavlink.MAVLink(None)  # whole messages: damage ends with a datagram
        parser.robust_parsing = True
        for message in parser.parse_buffer(data) or []:
            place = message.get_srcSystem() - 1
            if message.get_type() == "LOCAL_POSITION_NED" and place in range(len(self._names)):
                yield self._names[place], np.array([message.x, message.y, message.z])


def _parameter(robot: Any, group: str, key: str) -> object:
    """Return the value of a parameter that the server has read from a robot."""
    return robot.getParam(f"{group}.{key}")


class CrazyflieOutlet:
    """A fleet of Crazyflies behind crazyflie_py, the Python client of Crazyswarm2.

    Drones of the plan are robots of the fleet, whose world is east-north-up. Measurements are the
    poses that ``/NAME/pose`` carries, where the fleet's file logs them. Drones that do not hold
    their parameters are refused by UnsupportedError: the server reads them when it connects.
    """

    controllers = ("mellinger", "lee")  # those that add streamed accelerations

    def __init__(
        self,
        names: Sequence[str],
        robots: Sequence[str],
        frame: ReferenceFrame,
        parameters: Mapping[str, Parameters],
    ) -> None:
        try:
            rclpy, client = import_module("rclpy"), import_module("crazyflie_py")
            pose = import_module("geometry_msgs.msg").PoseStamped
        except ImportError as error:
            words = "source the setup of a ROS 2 workspace with Crazyswarm2 first"
            raise UnsupportedError(f"Crazyflies need crazyflie_py ({error}); {words}") from None
        self._node, self._frame = client.Crazyswarm().allcfs, frame
        known = self._node.crazyfliesByName
        for robot in robots:
            if robot not in known:
                raise InputError("fleet", robot, f"one of {', '.join(known)}", "name it in fleet=")
        self._robots = [known[robot] for robot in robots]
        self._set(dict(zip(robots, (parameters[name] for name in names), strict=True)))
        self._spin_once = partial(rclpy.spin_once, self._node, timeout_sec=0.0)
        self._places: dict[str, Array] = {}
        for name, robot in zip(names, robots, strict=True):
            heard = partial(self._heard, name)
            self._node.create_subscription(pose, f"/{robot}/pose", heard, 10)

    def _set(self, parameters: Mapping[str, Parameters]) -> None:
        """Refuse drones that do not hold their parameters, and set them again.

        A launch writes those of its own file after it has read.
        """
        known, faults = self._node.crazyfliesByName, []
        for name, wanted in parameters.items():
            held = partial(_parameter, known[name])
            if words := describe_differences(wanted, held):
                faults.append(f"{name}: {words}")
        if faults:
            faults.append(
                "launch twice with crazyflies.yaml of an export and query_all_values_on_connect: "
                "the first launch writes the parameters, the second reads what the drones hold"
            )
            raise UnsupportedError("\n".join(faults))
        for name, wanted in parameters.items():
            for group, values in wanted.items():
                for key, value in values.items():
                    known[name].setParam(f"{group}.{key}", value)

    def _heard(self, name: str, message: Any) -> None:
        place = message.pose.position
        point = np.array([place.x, place.y, place.z])
        if np.all(np.isfinite(point)):
            self._places[name] = self._frame.planned(point)

    def send(self, targets: FleetSetpoints, now: float) -> None:  # noqa: ARG002
        """Send every drone its full state."""
        frame, at = self._frame, targets.setpoints
        vectors = at.velocities, targets.feed_forward
        rows = [frame.points(at.positions), *map(frame.vectors, vectors)]
        rates = _turned(targets, frame).body_rates.tolist()
        for robot, row, rate in zip(self._robots, np.stack(rows, 1).tolist(), rates, strict=True):
            robot.cmdFullState(*row, frame.heading, rate)

    def measured(self) -> dict[str, Array]:
        """Return the poses' positions."""
        for _ in range(4 * len(self._robots)):
            self._spin_once()
        places, self._places = self._places, {}
        return places

    def arm(self) -> None:
        """Arm the drones that need it, which the others' client does not know."""
        for robot in self._robots:
            if hasattr(robot, "arm"):
                robot.arm(True)

    def close(self, *, landed: bool) -> None:
        """Give the drones back to their high-level commander, which puts down landed ones."""
        for robot in self._robots:
            robot.notifySetpointsStop(VALID)
        for robot in self._robots if landed else ():
            robot.land(LANDED, DOWN)
        self._spin_once()
