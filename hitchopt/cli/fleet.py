"""The commands for fleets: export, lint, abort and fly."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import (
    PATH,
    assignment_option,
    command,
    completing,
    key_option,
    option,
    plan_path,
)
from hitchopt.cli.output import ProgressBar, record, say, show_places, show_plan
from hitchopt.errors import FileError, InfeasibleError, InputError, Missing, UnsupportedError
from hitchopt.tables import table

if TYPE_CHECKING:
    import click

    from hitchopt.exports.exporting import Export
    from hitchopt.exports.lint import Report
    from hitchopt.live.ahead import AbortsAhead
    from hitchopt.live.fly import CommandedPlan, Outlet

FIRST_ABORTS = 5.0  # Seconds of a plan whose aborts are planned before it can begin
SAID_SHARE = 0.1  # Share of a plan after whose aborts a flight says how far they are planned
MAX_LISTED = 5  # Maximum number of findings listed per rule
HOWS = ("hold", "back", "release_and_land", "land")  # Aborts; the last two end a flight
THEN = ("hold", "land")  # What follows a loss
# Default first port; PX4's simulated vehicle i listens on 14580 + i
PORT = {"json": 14600, "mavlink": 14580}


def _placement_options() -> Sequence[click.Option]:
    """Return the options that place a plan in the frame of files or of drones."""
    from hitchopt.exports.options import ExportOptions
    from hitchopt.values.fields import keys_of

    keys = keys_of(ExportOptions)
    return (
        key_option("--origin", keys["origin"], "X Y Z"),
        key_option("--yaw-deg", keys["yaw"], "DEG"),
    )


def _format_option() -> Sequence[click.Option]:
    """Return the option for the format of an export, of hitchopt or of another package."""
    from hitchopt.exports.options import registered_formats

    names = [*registered_formats()]
    description = f"One of {', '.join(names)}."
    return (option("--format", description, str, "NAME", **completing(lambda: names)),)


def _export_options() -> Sequence[click.Option]:
    """Return the other options that ``ExportOptions`` declares."""
    from hitchopt.exports.options import ExportOptions
    from hitchopt.values.fields import keys_of

    keys = keys_of(ExportOptions)
    return (
        key_option("--frame", keys["frame"]),
        key_option("--rate", keys["rate"]),
        key_option("--stretch", keys["stretch"], "FACTOR"),
        key_option("--storage", keys["storage"]),
        key_option("--hold-tension", keys["hold_tension"]),
        key_option("--allow-slack", keys["allow_slack"]),
        key_option("--positions-only", keys["positions_only"]),
        key_option("--stiffness", keys["stiffness"]),
        key_option("--damping", keys["damping"], "N·S/M"),
    )


@command(
    "directory DIR",
    _format_option,
    option(
        "-o --output",
        "Output folder, or file for formats of one file; default: DIR-NAME.",
        PATH,
        "PATH",
    ),
    option(
        "--fleet",
        "YAML file that names drones, as drones: "
        "{q0: {name: cf1, uri: radio://…, type: cf21}, …}, or a crazyflies.yaml with a role for "
        "each robot.",
        PATH,
        "FILE",
    ),
    _placement_options,
    _export_options,
    required=False,
)
def export(directory: Path | None, output: Path | None, yaw_deg: float, **options: Any) -> None:
    """Export the plan in DIR to a format of fleets, scripts or viewers, and certify the files.

    Without DIR or --format it lists the formats.
    """
    from hitchopt.exports.exporting import export_flight
    from hitchopt.exports.format import format_of, usable_formats
    from hitchopt.exports.options import ExportOptions
    from hitchopt.exports.placing import read_fleet
    from hitchopt.motion.plan_file import read_saved_plan

    if directory is None or options["format"] is None:
        summaries = [(kind.name, type(kind).__doc__ or "") for kind in usable_formats()]
        rows = [{"format": name, "what it is": text.partition("\n")[0]} for name, text in summaries]
        say(table("Formats", rows), err=True)
        key, remedy = "format", "choose one, such as --format csv"
        if directory is None and options["format"]:
            key, remedy = "DIR", "name the directory of a plan"
        raise InputError(key, Missing(), "given", remedy)
    parsed = ExportOptions(yaw=math.radians(yaw_deg), **options)
    format_of(parsed.format)  # report an unknown name before reading the plan
    path = plan_path(directory)
    if output is None:
        output = _beside(path.parent, parsed.format)
    with ProgressBar("certifying") as progress:
        saved = read_saved_plan(path)
        exports = export_flight(saved, parsed, output, progress)
    addresses = dict[str, str]()
    if parsed.fleet is not None:
        members = read_fleet(parsed.fleet, saved.flight.team.listed_names).members
        addresses = {each.role: f"{each.name}, {each.uri}" for each in members}
    show_places(saved.flight, addresses)
    reported = set[str]()  # notes of earlier parts
    for part in exports:
        _report_part(part, reported)
        reported |= {*part.notes}
    record(parts=[_part_entry(part) for part in exports])


def _beside(directory: Path, kind: str) -> Path:
    """Return the directory of the exports of a plan's directory, next to it."""
    is_unnamed = directory.name in {"", ".."}
    parent = directory / ".." if is_unnamed else directory.parent
    return parent / f"{directory.resolve().name or 'plan'}-{kind}"


def _report_part(part: Export, reported: Collection[str]) -> None:
    """Print certificate, errors, new notes and files of an exported part."""
    verdict = part.verdict
    position, velocity = verdict.position, verdict.velocity
    say(str(ho.Certificate(verdict.duration, verdict.checks)))
    say(
        f"at most {1e3 * position.worst:.3g} mm ({position.drone}, t = {position.time:.3f} s) "
        f"and {1e3 * velocity.worst:.3g} mm/s ({velocity.drone}, t = {velocity.time:.3f} s) "
        f"from the plan, at all times\n{verdict.not_carried}"
    )
    for note in part.notes:
        if note not in reported:
            say(f"note: {note}")
    state = "exported; cables go slack" if part.goes_slack else "certified as exported"
    count = len(part.files)
    files = str(part.folder / part.files[0]) if count == 1 else f"{count} files in {part.folder}"
    say(f"{state}; {files}")


def _part_entry(part: Export) -> dict[str, Any]:
    """Return what ``--json`` has of an exported part."""
    verdict = asdict(part.verdict)
    return {
        "folder": str(part.folder),
        "files": part.files,
        "begins": part.begins,
        "position_error": verdict.pop("position"),
        "velocity_error": verdict.pop("velocity"),
        **verdict,
        "notes": part.notes,
        "goes_slack": part.goes_slack,
    }


def _rule_options() -> Sequence[click.Option]:
    """Return the option for the limits of lint."""
    from hitchopt.exports.lint import Rules
    from hitchopt.values.fields import keys_of

    rules, separation = keys_of(Rules), keys_of(ho.Separation)
    limits = {name: rules[name] for name in ("speed", "acceleration")}
    semi_axes = {name: separation[name] for name in ("radius", "height")}
    words = "Limit, such as speed=2; may be repeated."
    return (assignment_option("--set limits", words, limits | semi_axes),)


@command("paths PATH...", _rule_options, nargs=-1, required=True)
def lint(paths: tuple[Path, ...], limits: dict[str, float]) -> None:
    """Check fleet files from any source and report errors.

    Each PATH is a file or a folder of any format that `export` writes, and a flight of its own.
    Limits that a show declares are always checked. Exits with code 3 if there are errors.
    """
    from hitchopt.exports.lint import Rules

    semi_axes = {name: limits[name] for name in ("radius", "height") if name in limits}
    separation = ho.Separation(**semi_axes)
    rules = Rules(limits.get("speed"), limits.get("acceleration"), separation)
    with ProgressBar("reading and checking"):
        reports = ho.lint(paths, rules)
    entries = []
    for report in reports:
        entry = asdict(report)
        entry |= {"path": str(report.path), "sound": report.sound, "drones": entry.pop("facts")}
        entries.append(entry)
        _say_report(report)
    record(reports=entries)
    if not all(report.sound for report in reports):
        exit_infeasible()


def _say_report(report: Report) -> None:
    """Print the figures, the findings, and their numbers."""
    from hitchopt.exports.contents import ERROR, WARNING
    from hitchopt.exports.formats.crazyflie import BYTES
    from hitchopt.values import counted

    facts, flight = report.facts, report.flight
    figures: list[tuple[str, float | None, float | None]] = [
        ("speed [m/s]", flight.speed, flight.speed_limit),
        ("acceleration [m/s²]", flight.acceleration, flight.acceleration_limit),
        *(
            (f"{own.name} [{own.unit}], declared by the show", own.worst, own.limit)
            for own in flight.own
        ),
        ("separation [ellipsoids]", flight.separation, 1.0),
        ("largest distance from the origin [m]", flight.reach, None),
        ("pieces of a drone", max(fact.pieces or 0 for fact in facts) or None, None),
        ("bytes of a drone", max(fact.size or 0 for fact in facts) or None, BYTES),
    ]
    for size, unit in zip(flight.jumps, ("m", "m/s", "m/s²"), strict=False):
        figures.append((f"jump between pieces [{unit}]", size, None))
    frame = f", frame {report.frame}" if report.frame else ""
    drones = counted(len(facts), "drone")
    title = f"{report.path}: {report.kind}, {drones}{frame}, {flight.duration:.3f} s"
    heads = ("figure", "worst", "limit")
    say(table(title, [dict(zip(heads, row, strict=True)) for row in figures if row[1] is not None]))
    by_rule: dict[tuple[str, str], list[str]] = {}
    for finding in report.findings:
        by_rule.setdefault((finding.level, finding.rule), []).append(str(finding))
    for (level, rule), lines in by_rule.items():
        if (more := len(lines) - MAX_LISTED) > 0:
            lines[MAX_LISTED:] = [f"{level}: {rule}: and {more} more"]
        say("\n".join(lines), err=level == ERROR)
    levels = [finding.level for finding in report.findings]
    say(f"{levels.count(ERROR)} errors, {levels.count(WARNING)} warnings")


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


@command(
    "directory DIR",
    option(
        "--lose", "Robot that is lost: its number, or a.2 of team a.", str, "ROBOT", required=True
    ),
    option("--at", "Time of the loss.", float, "SECONDS", required=True),
    option("-o --output", "Output directory.", PATH, "OUT", required=True),
    option(
        "--then",
        "Hold the chain that remains, or land: untied, tied, or without cables.",
        "hold",
        choices=THEN,
    ),
)
def react(directory: Path, lose: str, at: float, output: Path, then: str) -> None:
    """Plan what follows the loss of a robot in flight, and certify it.

    Writes a plan to OUT. It begins with the loss: all fly on, for 0.1 s or to the next prepared
    stop, the lost robot's drones rise, and the others form a chain.
    """
    from hitchopt.losses.losing import after_loss_of
    from hitchopt.motion.plan_file import read_plan

    flight = read_plan(plan_path(directory))
    with ProgressBar("planning"):
        found = after_loss_of(flight, lose, at, then)
    plan = ho.Plan(found.flight, found.certificate, f"Robot {lose} lost at {at:g} s")
    show_plan(plan.title, plan.flight, plan.certificate)
    plan.save(output)
    rests = f"all rest within {found.stops:.3f} s, where the plan is at t = {found.rest:.3f} s"
    if found.robots:
        say(
            f"after the loss, {rests}; drones at the ends begin to move after {found.starts:.3f} "
            f"s, and the chain is taut after {found.taut:.3f} s"
        )
        names = ", ".join(f"{own} is {old}" for own, old in found.robots.items())
        say(f"robots: {names}")
    else:
        say(f"no landing of the chain is certified: all drop their cables, {rests}, and land")
    say(
        f"certified; the plan is in {output}",
        directory=str(output),
        stops=found.stops,
        rest=found.rest,
        starts=found.starts,
        taut=found.taut,
        rise=found.rise,
        robots=found.robots,
    )


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
    _placement_options,
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
