"""The command ``fly``: setpoints streamed to a fleet, steered by keys."""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hitchopt.cli.abort_command import HOWS
from hitchopt.cli.commands import main
from hitchopt.cli.failures import UNMET
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path

if TYPE_CHECKING:
    from hitchopt.flying.datagrams import Address, Datagrams
    from hitchopt.flying.flight import Flight
    from hitchopt.flying.outlet import Outlet
    from hitchopt.hitch import Swarm, Team
    from hitchopt.motion.motion import Motion
    from hitchopt.stopping.abort_table import AbortTable

OVER = ("json", "mavlink", "crazyflie")

PORT = {"json": 14600, "mavlink": 14580}
"""First port where nothing else is named: PX4's simulated vehicle i listens on 14580 + i."""


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
@click.option(
    "--over",
    type=click.Choice([*OVER]),
    required=True,
    help="json: UDP datagrams; mavlink: offboard setpoints over UDP (needs pymavlink); crazyflie: "
    "crazyflie_py of Crazyswarm2.",
)
@click.option(
    "--to",
    "targets",
    metavar="HOST:PORT",
    multiple=True,
    help="Address of all drones, or once for each; by default this machine, from port 14600 (json) "
    "or 14580 (mavlink) on, one port for each drone.",
)
@click.option(
    "--listen",
    metavar="HOST:PORT",
    default="127.0.0.1:0",
    help="Where the stream comes from and measurements arrive; name this machine's address on the "
    "drones' network.",
)
@click.option(
    "--operator",
    metavar="HOST:PORT",
    help="Listen there for the commands and heartbeats of another machine, and require them.",
)
@click.option("--fleet", metavar="FILE", type=GivenPath(), help="Names of the Crazyflies.")
@click.option(
    "--origin",
    metavar="X Y Z",
    type=(float, float, float),
    default=(0.0, 0.0, 0.0),
    help="Where the plan's origin lies for the drones: east, north, up [m].",
)
@click.option("--yaw-deg", metavar="DEG", default=0.0, help="Angle by which the plan is turned.")
@click.option("--rate", metavar="HZ", default=50.0, help="Setpoints per second and drone.")
@click.option(
    "--how",
    type=click.Choice([*HOWS[2:]]),
    help="What key a does: by default what aborts.json in DIR does, else release_and_land, land "
    "without cables.",
)
@click.option("--patience", metavar="SECONDS", default=5.0, help="From a lost link to landing.")
@click.option(
    "--measurements/--no-measurements",
    default=True,
    help="Whether drones must be measured: a silence of 0.5 s is a lost link.",
)
def fly(directory: Path, how: str | None, patience: float, rate: float, **options: Any) -> None:
    """Stream the setpoints of the plan in DIR to drones, steered by keys.

    The stream begins at rest at the plan's start. Keys: space to resume and to pause, b back,
    a abort, l land, q quit before the start; Ctrl-C lands. All of it is certified: the clock's
    changes, and the aborts: those that hitchopt abort has written to DIR, certified anew, and
    others are planned first. A lost operator or lost measurements end in a
    hold, then in a landing. Ends with 3 unless the drones have landed.
    """
    from hitchopt.flying.course import Course
    from hitchopt.flying.flight import Flight, Timing
    from hitchopt.flying.operator_link import KEYS_HELP, OperatorLink, terminal_keys
    from hitchopt.plan import load

    timing = Timing(rate=rate, patience=patience)
    plan = load(plan_path(directory).parent)
    plan.certificate.raise_if_violated()
    motion = plan.motion
    reach = _outlet_of(motion.team, **options)
    tables = _tables(plan_path(directory).parent, motion, how)
    watched = motion.team.drone_names if options["measurements"] else ()
    with (
        ThreadPoolExecutor(2) as workers,
        terminal_keys() as keys,
        _listening(options["operator"]) as remote,
    ):
        steering = OperatorLink(keys, remote)
        course = Course(motion, tables, workers.submit)
        outlet = reach()
        flight = Flight(course, outlet, steering, timing, watched, workers.submit, say)
        say(f"streaming at {rate:g} Hz, at rest at the plan's start; {KEYS_HELP}, Ctrl-C land")
        with _signals(steering.add):
            try:
                _stream(flight, 1.0 / rate)
            finally:
                outlet.close(landed=flight.landed)
    record(landed=flight.landed, late=flight.late)
    if flight.late:
        say(f"{flight.late} setpoints were late by {1e3 / rate:.0f} ms, as commands took longer")
    say("landed" if flight.landed else "not landed", err=not flight.landed)
    if not flight.landed:
        click.get_current_context().exit(UNMET)


@contextmanager
def _listening(operator: str | None) -> Iterator[Datagrams | None]:
    """Give the socket for an operator on another machine, if there is one."""
    from hitchopt.flying.datagrams import Datagrams, address

    if operator is None:
        yield None
        return
    datagrams = Datagrams(address("--operator", operator))
    try:
        yield datagrams
    finally:
        datagrams.close()


def _outlet_of(
    team: Team | Swarm,
    *,
    over: str,
    targets: tuple[str, ...],
    listen: str,
    fleet: Path | None,
    origin: tuple[float, float, float],
    yaw_deg: float,
    **_: Any,
) -> Callable[[], Outlet]:
    """Return what reaches the fleet that the options name; wrong options are found at once."""
    from hitchopt.exports.fleet import placeholder_fleet, read_fleet
    from hitchopt.exports.reference_frame import ReferenceFrame
    from hitchopt.flying.crazyflie_outlet import crazyflie_outlet
    from hitchopt.flying.datagrams import Datagrams, address
    from hitchopt.flying.json_outlet import JsonOutlet
    from hitchopt.flying.mavlink_outlet import MavlinkOutlet, messages

    names = team.drone_names
    frame = ReferenceFrame("ned" if over == "mavlink" else "enu", origin, math.radians(yaw_deg))
    if over == "crazyflie":
        members = (placeholder_fleet(names) if fleet is None else read_fleet(fleet, names)).members
        robots = [member.name for member in members]
        return partial(crazyflie_outlet, names, robots, frame)
    places, here = _targets(targets, len(names), PORT[over]), address("--listen", listen)
    if over == "json":
        return lambda: JsonOutlet(names, places, frame, Datagrams(here))
    messages()
    return lambda: MavlinkOutlet(names, places, frame, Datagrams(here))


def _targets(given: tuple[str, ...], count: int, port: int) -> list[Address]:
    """Return an address for each drone."""
    from hitchopt.errors import InputError
    from hitchopt.flying.datagrams import address

    if not given:
        return [("127.0.0.1", port + i) for i in range(count)]
    if len(given) not in (1, count):
        raise InputError("--to", len(given), f"given once, or {count} times", "one for each drone")
    found = [address("--to", each) for each in given]
    return found * count if len(found) == 1 else found


def _tables(directory: Path, motion: Motion, how: str | None) -> dict[str, AbortTable]:
    """Return the aborts for the commands ``abort`` and ``land``: those of the directory, or new."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.errors import InfeasibleError
    from hitchopt.stopping.abort_table import abort_table, read_aborts

    with LateProgress(sys.stderr, "reading aborts") as progress:
        saved = read_aborts(directory, motion, progress)
    usual = "release_and_land" if motion.team.has_cables else "land"
    if how is None and saved is not None and saved.how in HOWS[2:]:
        usual = saved.how
    chosen = how or usual
    found = {}
    with LateProgress(sys.stderr, "planning aborts") as progress:
        for each in dict.fromkeys(("land", chosen)):
            if saved is not None and saved.how == each:
                say(f"{each}: {len(saved.entries)} entries of aborts.zip, certified anew")
                found[each] = saved
            else:
                found[each] = abort_table(motion, each, progress=progress)
            if not found[each].entries:
                remedy = "a lost link could not end on the ground; choose another --how"
                raise InfeasibleError([], f"no abort {each} was found; {remedy}")
    return {"land": found["land"], "abort": found[chosen]}


@contextmanager
def _signals(add: Callable[[str], None]) -> Iterator[None]:
    """Let SIGINT and SIGTERM land within the context, the second of them end it at once.

    A terminal that is closed is a lost operator, so SIGHUP is ignored.
    """
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

    def end(number: int, frame: Any) -> None:  # noqa: ARG001
        add("end")
        signal.signal(number, before[signal.Signals(number)])

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stream(flight: Flight, period: float) -> None:
    """Tick until the flight ends."""
    due = time.monotonic()
    while flight.tick(time.monotonic()):
        due = max(due + period, time.monotonic() - period)
        time.sleep(max(0.0, due - time.monotonic()))
