"""Links of a flight: datagrams, the operator's keys, and fleets that are sent setpoints.

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
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.exports.formats.crazyswarm2 import LANDED
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.live.fly import Flown
from hitchopt.motion.states import Attitudes, attitudes
from hitchopt.values import MAX_COORDINATE, Array

Address = tuple[str, int]

LARGEST, MOST = 65536, 1000
"""Size of the largest datagram [B], and number that are read at once: a flood must not stop the
stream."""

FORMAT = "hitchopt-setpoint/1"

OWN_SYSTEM = 245
"""System number of this MAVLink sender, beyond those of usual fleets and below ground stations'."""

BEAT = 1.0
"""[s] Period of heartbeats: autopilots take a sender for lost after some seconds."""

VALID, DOWN = 500, 1.0
"""[ms] How long a Crazyflie's last setpoint remains valid when the stream ends; [s] time in which
the firmware puts down landed ones."""

KEYS = {
    " ": "toggle",
    "p": "pause",
    "r": "resume",
    "b": "back",
    "a": "abort",
    "l": "land",
    "q": "quit",
}
"""What keys ask for; ``toggle`` is pause or resume, ``quit`` ends what has not left its start. Of
signals there is ``end`` as well: land, or quit."""

KEYS_HELP = "space pause/resume, b back, a abort, l land, q quit before the start"


def address(key: str, text: str) -> Address:
    """Return the numeric address that ``HOST:PORT`` names.

    Raises
    ------
    InputError: it is none, or the host is unknown.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 65536:
        raise InputError(key, text, "HOST:PORT", "such as 127.0.0.1:14540")
    try:
        found = socket.getaddrinfo(host, int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(key, text, "a known host", f"write its address ({error})") from None
    return str(found[0][4][0]), int(port)


class Datagrams:
    """A UDP socket that never waits.

    Parameters
    ----------
    listen: where it receives; port 0 is any free one.

    Raises
    ------
    UnsupportedError: the address is taken, or not this machine's.
    """

    def __init__(self, listen: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(listen)
        except OSError as error:
            self._socket.close()
            words = f"{listen[0]}:{listen[1]} cannot be listened on: {error.strerror or error}"
            raise UnsupportedError(words) from None

    @property
    def port(self) -> int:
        """Port that it listens on."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; one that the network does not take is lost like any other."""
        with suppress(OSError):
            self._socket.sendto(data, to)

    def received(self) -> Iterator[tuple[bytes, Address]]:
        """Yield what has arrived, with its senders."""
        for _ in range(MOST):
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                return
            except OSError:  # an answer that a port is closed
                continue
            yield data, sender

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _json_object(data: bytes) -> dict[str, Any]:
    """Return the JSON object in a datagram; an empty one where there is none."""
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


class OperatorLink:
    """Commands of an operator, and whether there still is one.

    Parameters
    ----------
    keys: reads the keys pressed since the last call, None where the terminal has gone.
    datagrams: socket for commands of another machine, whose heartbeats are then required:
        ``{"command": "pause"}``, or ``{}`` as a heartbeat alone.
    """

    def __init__(self, keys: Callable[[], str | None], datagrams: Datagrams | None = None) -> None:
        self._keys = keys
        self._datagrams = datagrams
        self._added: list[str] = []

    def add(self, command: str) -> None:
        """Give a command as if a key were pressed: signals do."""
        self._added.append(command)

    def commands(self) -> tuple[list[str], bool]:
        """Return the commands since the last call, and whether the operator was heard of."""
        found, self._added = self._added, []
        pressed = self._keys()
        found += [KEYS[key] for key in (pressed or "").lower() if key in KEYS]
        if self._datagrams is None:
            return found, pressed is not None
        heard = False
        for data, _ in self._datagrams.received():
            given = _json_object(data).get("command")
            heard = heard or data.lstrip()[:1] == b"{"
            if given in KEYS.values():
                found.append(str(given))
        return found, heard


@contextmanager
def terminal_keys() -> Iterator[Callable[[], str | None]]:
    """Give a function that returns the keys pressed on standard input, None at its end.

    A terminal gives each key at once within the context, and shows none.
    """
    try:
        number = sys.stdin.fileno()
    except (AttributeError, ValueError, OSError):  # closed, or replaced by an object
        yield lambda: None
        return
    ended = False

    def pressed() -> str | None:
        nonlocal ended
        if ended:
            return None
        if not select.select([number], [], [], 0.0)[0]:
            return ""
        try:
            data = os.read(number, 1024)
        except OSError:  # the terminal has gone
            data = b""
        ended = not data
        return None if ended else data.decode("utf-8", "ignore")

    if not sys.stdin.isatty():
        yield pressed
        return
    import termios
    import tty

    before = termios.tcgetattr(number)
    tty.setcbreak(number)
    try:
        yield pressed
    finally:
        with suppress(termios.error):  # the terminal may have gone
            termios.tcsetattr(number, termios.TCSADRAIN, before)


def _turned(flown: Flown, frame: ReferenceFrame) -> Attitudes:
    """Return attitudes and body rates of the thrusts in a frame."""
    both = frame.vectors(flown.thrusts), frame.vectors(flown.thrust_rates)
    return attitudes(*both, frame.heading)


class DatagramOutlet(ABC):
    """A fleet behind UDP; answers of hosts that are sent nothing are ignored.

    Parameters
    ----------
    names: of the drones.
    addresses: where each of them listens; equal ones for a router.
    frame: axes of what is sent.
    datagrams: the socket.
    """

    def __init__(
        self,
        names: Sequence[str],
        addresses: Sequence[Address],
        frame: ReferenceFrame,
        datagrams: Datagrams,
    ) -> None:
        self._names, self._addresses = tuple(names), tuple(addresses)
        self._frame, self._datagrams = frame, datagrams

    @abstractmethod
    def _answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        """Yield whose positions a datagram tells, and where they are in the frame."""

    def measured(self) -> dict[str, Array]:
        """Return measured positions (3,) [m] in the plan's axes, by the drones' names."""
        hosts = {host for host, _ in self._addresses}
        found: dict[str, Array] = {}
        for data, (host, _) in self._datagrams.received():
            for name, point in self._answers(data) if host in hosts else ():
                if name in self._names and point.shape == (3,) and np.all(np.isfinite(point)):
                    found[str(name)] = self._frame.planned(point)
        return found

    def close(self, *, landed: bool) -> None:  # noqa: ARG002
        """Close the socket; autopilots leave offboard mode as they are set to."""
        self._datagrams.close()


class JsonOutlet(DatagramOutlet):
    """A fleet that reads JSON, one datagram for every drone and time.

    A receiver answers each datagram's sender with ``{"drone": "q0", "position": [x, y, z]}``,
    measured, in the axes of the setpoints (east-north-up).
    """

    _number = 0

    def send(self, flown: Flown, now: float) -> None:
        """Send every drone its setpoint."""
        frame, at = self._frame, flown.setpoints
        turned = _turned(flown, frame)
        rows = {
            "position": frame.points(at.positions),
            "velocity": frame.vectors(at.velocities),
            "acceleration": frame.vectors(at.accelerations),
            "jerk": frame.vectors(at.jerks),
            "feed_forward": frame.vectors(flown.feed_forward),
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
            self._datagrams.send(json.dumps({**head, "drone": name, **own}).encode(), to)
        self._number += 1

    def _answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        answer = _json_object(data)
        place = answer.get("position")
        if isinstance(place, list) and all(
            type(x) in (int, float) and abs(x) <= MAX_COORDINATE for x in place
        ):
            yield answer.get("drone"), np.array(place, dtype=np.float64)


def messages() -> Any:
    """Return pymavlink's definitions of messages.

    Raises
    ------
    UnsupportedError: pymavlink is not installed.
    """
    try:
        return import_module("pymavlink.dialects.v20.common")
    except ImportError as error:
        words = f"MAVLink needs the package pymavlink ({error}); pip install 'hitchopt[fly]'"
        raise UnsupportedError(words) from None


class MavlinkOutlet(DatagramOutlet):
    """A fleet of autopilots in offboard mode, whose north-east-down axes share one origin.

    Drone ``i`` of the plan is system ``i + 1``. SET_POSITION_TARGET_LOCAL_NED sets position,
    velocity, acceleration and yaw; they answer with LOCAL_POSITION_NED.
    """

    def __init__(self, *fleet: Any) -> None:
        super().__init__(*fleet)
        self._mavlink = messages()
        self._sender = self._mavlink.MAVLink(None, srcSystem=OWN_SYSTEM)
        self._begun: float | None = None
        self._beaten = -math.inf

    def send(self, flown: Flown, now: float) -> None:
        """Send every autopilot its setpoint, and a heartbeat now and then."""
        frame, at, link = self._frame, flown.setpoints, self._mavlink
        if self._begun is None:
            self._begun = now
        if now - self._beaten >= BEAT:
            self._beaten = now
            kind = (link.MAV_TYPE_ONBOARD_CONTROLLER, link.MAV_AUTOPILOT_INVALID)
            beat = self._sender.heartbeat_encode(*kind, 0, 0, link.MAV_STATE_ACTIVE)
            for to in dict.fromkeys(self._addresses):
                self._datagrams.send(beat.pack(self._sender), to)
        parts = (
            frame.points(at.positions),
            frame.vectors(at.velocities),
            frame.vectors(flown.feed_forward),
        )
        boot = int(1e3 * (now - self._begun)) % 2**32
        mask = link.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
        axes = (link.MAV_FRAME_LOCAL_NED, mask)
        for i, row in enumerate(np.concatenate(parts, axis=-1).tolist()):
            message = self._sender.set_position_target_local_ned_encode(
                boot, i + 1, link.MAV_COMP_ID_AUTOPILOT1, *axes, *row, frame.heading, 0.0
            )
            self._datagrams.send(message.pack(self._sender), self._addresses[i])

    def _answers(self, data: bytes) -> Iterator[tuple[object, Array]]:
        parser = self._mavlink.MAVLink(None)  # whole messages: damage ends with a datagram
        parser.robust_parsing = True
        for message in parser.parse_buffer(data) or []:
            place = message.get_srcSystem() - 1
            if message.get_type() == "LOCAL_POSITION_NED" and place in range(len(self._names)):
                yield self._names[place], np.array([message.x, message.y, message.z])


class CrazyflieOutlet:
    """A fleet of Crazyflies behind crazyflie_py, the Python client of Crazyswarm2.

    Measurements are the poses that ``/NAME/pose`` carries, where the fleet's file logs them.

    Parameters
    ----------
    names: of the drones in the plan.
    robots: their names in the fleet.
    frame: axes of the fleet's world, east-north-up.
    swarm: a ``Crazyswarm``; its ``allcfs`` is a node of ROS.
    spin: lets ROS handle what has arrived.
    pose: class of the messages of poses.

    Raises
    ------
    InputError: the fleet has no robot of a name.
    """

    def __init__(
        self,
        names: Sequence[str],
        robots: Sequence[str],
        frame: ReferenceFrame,
        swarm: Any,
        spin: Callable[[], None],
        pose: type,
    ) -> None:
        known = swarm.allcfs.crazyfliesByName
        for robot in robots:
            if robot not in known:
                raise InputError("fleet", robot, f"one of {', '.join(known)}", "name it in --fleet")
        self._robots = [known[robot] for robot in robots]
        self._frame, self._spin = frame, spin
        self._found: dict[str, Array] = {}
        for name, robot in zip(names, robots, strict=True):
            heard = partial(self._heard, name)
            swarm.allcfs.create_subscription(pose, f"/{robot}/pose", heard, 10)

    def _heard(self, name: str, message: Any) -> None:
        place = message.pose.position
        point = np.array([place.x, place.y, place.z])
        if np.all(np.isfinite(point)):
            self._found[name] = self._frame.planned(point)

    def send(self, flown: Flown, now: float) -> None:  # noqa: ARG002
        """Send every drone its full state."""
        frame, at = self._frame, flown.setpoints
        rows = zip(
            self._robots,
            frame.points(at.positions).tolist(),
            frame.vectors(at.velocities).tolist(),
            frame.vectors(flown.feed_forward).tolist(),
            _turned(flown, frame).body_rates.tolist(),
            strict=True,
        )
        for robot, position, velocity, forward, rates in rows:
            robot.cmdFullState(position, velocity, forward, frame.heading, rates)

    def measured(self) -> dict[str, Array]:
        """Return the poses' positions."""
        self._spin()
        found, self._found = self._found, {}
        return found

    def close(self, *, landed: bool) -> None:
        """Give the drones back to their high-level commander, which puts down landed ones."""
        for robot in self._robots:
            robot.notifySetpointsStop(VALID)
        for robot in self._robots if landed else ():
            robot.land(LANDED, DOWN)
        self._spin()


def crazyflie_outlet(
    names: Sequence[str], robots: Sequence[str], frame: ReferenceFrame
) -> CrazyflieOutlet:
    """Return the fleet that the running Crazyswarm2 server has.

    Raises
    ------
    UnsupportedError: there is no ROS with crazyflie_py here.
    InputError: the fleet has no robot of a name.
    """
    try:
        rclpy, client = import_module("rclpy"), import_module("crazyflie_py")
        pose = import_module("geometry_msgs.msg").PoseStamped
    except ImportError as error:
        words = "source the setup of a ROS 2 workspace with Crazyswarm2 first"
        raise UnsupportedError(f"Crazyflies need crazyflie_py ({error}); {words}") from None
    swarm = client.Crazyswarm()

    def spin() -> None:
        for _ in range(4 * len(names)):
            rclpy.spin_once(swarm.allcfs, timeout_sec=0.0)

    return CrazyflieOutlet(names, robots, frame, swarm, spin, pose)
