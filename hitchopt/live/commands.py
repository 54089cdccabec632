"""The commands abort and fly: plans in flight."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import PATH, command, option, plan_path
from hitchopt.cli.output import ProgressBar, say
from hitchopt.errors import FileError, InfeasibleError, InputError, UnsupportedError
from hitchopt.exports.commands import placement_options
from hitchopt.tables import table

if TYPE_CHECKING:
    from hitchopt.live.ahead import AbortsAhead
    from hitchopt.live.fly import CommandedPlan, Outlet

FIRST_ABORTS = 5.0  # Seconds of a plan whose aborts are planned before it can begin
SAID_SHARE = 0.1  # Share of a plan after whose aborts a flight says how far they are planned
HOWS = ("hold", "back", "release_and_land", "land")  # Aborts; the last two end a flight
# Default first port; PX4's simulated vehicle i listens on 14580 + i
PORT = {"json": 14600, "mavlink": 14580}


@command(
    "directory DIR",
    option(
        "--how",
        "Stop; fly back until cables hang free; untie and land; or land straight down. Default: "
        "release_and_land, or land without cables.",
        None,
        choices=HOWS,
    ),
    option("--every", "Time between entries.", 2.0, "SECONDS"),
)
def abort(directory: Path, how: str | None, every: float) -> None:
    """Plan and certify aborts from all times of the plan in DIR.

    Writes aborts.json and aborts.zip to DIR. From any time, the common clock runs to the next
    entry and slows to rest, where the entry's plan continues. Exits with code 3 if no abort was
    found from some times.
    """
    from hitchopt.checks.certifying import certificate_of
    from hitchopt.checks.drones import largest_at_rest, thrust_share, tilt
    from hitchopt.live.abort import abort_table, read_aborts, save_aborts
    from hitchopt.motion.plan_file import read_plan

    path = plan_path(directory)
    flight = read_plan(path)
    how = how or _default_abort(flight)
    with ProgressBar("planning aborts") as progress:
        certificate_of(flight, progress).raise_if_violated()
        aborts = abort_table(flight, how, every, progress)
    rows = []
    for entry in aborts.entries:
        phase = next((p for p in flight.phases if p.end >= entry.rest - 1e-6), flight.phases[-1])
        times = {"commands until": entry.start, "at rest after": entry.start + entry.seconds}
        times["ends"] = entry.flight.duration
        rows.append({"phase": phase.name, **{name: f"{t:.3f} s" for name, t in times.items()}})
    say(table(f"Aborts: {how}", rows))
    thrust, angle = (
        max(largest_at_rest(each.motion, quantity) for each in flight.teams)
        for quantity in (thrust_share, tilt)
    )
    needed = f"{thrust:.1%} of a drone's thrust and a tilt of {angle:.2f}°"
    say(f"hovering anywhere on the paths needs up to {needed}")
    tables = read_aborts(path.parent, flight) | {how: aborts}
    save_aborts(path.parent, flight, tables.values())
    say(
        f"aborts.json and aborts.zip are in {path.parent}",
        directory=str(path.parent),
        how=aborts.how,
        entries=[{"start": entry.start, "seconds": entry.seconds} for entry in aborts.entries],
        longest=aborts.longest if aborts.entries else None,
        missing=[list(span) for span in aborts.missing],
    )
    if aborts.entries:
        say(f"at rest within {aborts.longest:.3f} s of any command")
    if aborts.missing:
        spans = ", ".join(f"{a:.4g} s to {b:.4g} s" for a, b in aborts.missing)
        say(f"no abort was found for commands from {spans}", err=True)
        exit_infeasible()


def _default_abort(flight: ho.Flight) -> str:
    return "release_and_land" if flight.has_cables else "land"


@command(
    "directory DIR",
    option(
        "--over",
        "UDP datagrams; offboard setpoints over UDP (needs pymavlink); or crazyflie_py of "
        "Crazyswarm2.",
        str,
        choices=("json", "mavlink", "crazyflie"),
        required=True,
    ),
    option(
        "--to targets",
        "Address of all drones, or one per drone; default: this machine, one port per drone from "
        "14600 (json) or 14580 (mavlink).",
        str,
        "HOST:PORT",
        multiple=True,
    ),
    option(
        "--listen",
        "Local address that sends setpoints and receives measurements; use this machine's "
        "address on the drones' network.",
        "127.0.0.1:0",
        "HOST:PORT",
    ),
    option("--fleet", "File with the names of the Crazyflies.", PATH, "FILE"),
    placement_options,
    option("--rate", "Setpoints per second for each drone.", 50.0, "HZ"),
    option(
        "--how",
        "Action of key a; default: release_and_land, or land without cables.",
        None,
        choices=HOWS[2:],
    ),
    option("--patience", "Time from a lost link to landing.", 5.0, "SECONDS"),
    option(
        "--measurements/--no-measurements",
        "Treat 0.5 s without measurements as a lost link.",
        True,
    ),
)
def fly(
    directory: Path,
    how: str | None,
    patience: float,
    rate: float,
    *,
    measurements: bool,
    **options: Any,
) -> None:
    """Stream the setpoints of the plan in DIR to drones, controlled by keys.

    The stream begins at rest at the plan's start. Keys: space resumes and pauses, b flies back, a
    aborts, l lands, q quits before the start; x2 and Enter: robot 2 is lost, and the others hold
    what remains (hitchopt react); Ctrl-C lands. All changes of the clock and all aborts
    are certified; aborts of the first seconds are planned first, the others meanwhile, and saved in
    DIR. A lost operator or lost measurements lead to a hold, then to a landing. Exits with code 3
    unless the drones have landed.
    """
    from hitchopt.live.abort import AbortTable, read_aborts, save_aborts
    from hitchopt.live.ahead import AbortsAhead
    from hitchopt.live.fly import CommandedPlan, SetpointStream
    from hitchopt.live.links import KEYS_HELP, Operator
    from hitchopt.values import positive

    if not hasattr(signal, "SIGHUP"):
        raise UnsupportedError("fly needs Linux or macOS; on Windows use WSL")
    rate, patience = positive("rate", rate), positive("patience", patience)
    path = plan_path(directory)
    with ProgressBar("certifying"):
        plan = ho.load(path.parent)
    plan.certificate.raise_if_violated()
    flight = plan.flight
    outlet = _outlet_of(flight, **options)
    watched = flight.team.drone_names if measurements else ()
    how, operator = how or _default_abort(flight), Operator()
    saved = read_aborts(path.parent, flight)
    ahead = AbortsAhead(
        flight,
        {each: saved.get(each) or AbortTable.unplanned(flight, each) for each in ("land", how)},
    )
    with ThreadPoolExecutor(2) as workers, ahead.planning():
        _await_first(ahead)
        tables = {"land": ahead.tables["land"], "abort": ahead.tables[how]}
        commanded = CommandedPlan(flight, tables)
        parts = commanded, outlet, operator.commands, watched, workers.submit, say
        stream = SetpointStream(*parts, rate=rate, patience=patience)
        extending = workers.submit(_extend, commanded, ahead, how)
        say(
            f"streaming at {rate:g} Hz, at rest at the plan's start; keys: {KEYS_HELP}, Ctrl-C land"
        )
        with operator.attached(), _land_on_signals(operator.add):
            due = time.monotonic()
            try:
                while stream.tick(time.monotonic()):
                    ahead.clock.value = commanded.time
                    due = max(due + 1.0 / rate, time.monotonic() - 1.0 / rate)
                    time.sleep(max(0.0, due - time.monotonic()))
            finally:
                outlet.close(landed=stream.landed)
    extending.result()
    try:
        save_aborts(path.parent, flight, (saved | ahead.to_save).values())
    except FileError as error:
        say(str(error), err=True)
    landed, late = stream.landed, stream.late
    if late:
        subject = "1 setpoint was" if late == 1 else f"{late} setpoints were"
        say(f"{subject} up to {1e3 / rate:.0f} ms late: a command took too long")
    say("landed" if landed else "not landed", err=not landed, landed=landed, late=late)
    if not landed:
        exit_infeasible()


def _outlet_of(
    flight: ho.Flight,
    over: str,
    targets: tuple[str, ...],
    listen: str,
    fleet: Path | None,
    origin: tuple[float, float, float],
    yaw_deg: float,
) -> Outlet:
    """Return the connection to the fleet that the options specify."""
    from hitchopt.exports.firmware import refuse_controllers, team_parameters
    from hitchopt.exports.formats.crazyflie import pilot_checklist
    from hitchopt.exports.placing import ReferenceFrame, placeholder_fleet, read_fleet
    from hitchopt.live.links import CrazyflieOutlet, JsonOutlet, MavlinkOutlet, address

    team, names = flight.team, flight.team.listed_names
    kind: Any = {"json": JsonOutlet, "mavlink": MavlinkOutlet, "crazyflie": CrazyflieOutlet}[over]
    refuse_controllers(team, kind.controllers, f"--over {over}")
    frame = ReferenceFrame("ned" if over == "mavlink" else "enu", origin, math.radians(yaw_deg))
    if over == "crazyflie":
        members = (placeholder_fleet(names) if fleet is None else read_fleet(fleet, names)).members
        robots = [member.name for member in members]
        crazyflies = CrazyflieOutlet(names, robots, frame, team_parameters(team))
        say(pilot_checklist(flight))
        return crazyflies
    own_address = address("--listen", listen)
    addresses = [address("--to", each) for each in targets]
    if not addresses:
        addresses = [("127.0.0.1", PORT[over] + i) for i in range(len(names))]
    if len(addresses) not in (1, len(names)):
        bound = f"given once, or {len(names)} times"
        raise InputError(
            "targets", len(addresses), bound, "name one for all drones, or one for each"
        )
    addresses *= len(names) // len(addresses)
    outlet: Outlet = kind(names, addresses, frame, own_address)
    return outlet


def _await_first(ahead: AbortsAhead) -> None:
    """Wait for the aborts of the plan's first seconds, and for one of each reaction."""
    with ProgressBar("planning the first aborts") as progress:
        while not ahead.covers(FIRST_ABORTS):
            progress(f"planning the first aborts, {ahead.planned:.0%} of all")
            if not ahead.receive():
                raise RuntimeError("the process that plans aborts has ended")
    for how, aborts in ahead.tables.items():
        if not aborts.entries:
            remedy = "after a lost link, drones could not land; choose another --how"
            raise InfeasibleError([], f"no abort {how} was found; {remedy}")


def _extend(commanded: CommandedPlan, ahead: AbortsAhead, how: str) -> None:
    """Extend the tables of a flight as its aborts are planned, and say how far they are."""
    said = ahead.planned
    while extended := ahead.receive():
        for key, reaction in (("land", "land"), ("abort", how)):
            if reaction == extended:
                commanded.extend(key, ahead.tables[reaction])
        if ahead.planned >= said + SAID_SHARE or ahead.planned == 1.0 != said:
            said = ahead.planned
            say(f"aborts are planned for {said:.0%} of the plan")


@contextmanager
def _land_on_signals(add: Callable[[str], None]) -> Iterator[None]:
    """Let SIGINT and SIGTERM add the command ``end`` within the context; a second one is immediate.

    SIGHUP is ignored, because a closed terminal is a lost operator.
    """
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in signals}

    def end(number: int, _: Any) -> None:
        add("end")
        signal.signal(number, handlers[number])

    for number in signals[:2]:
        signal.signal(number, end)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        yield
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
