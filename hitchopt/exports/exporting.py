"""Export a certified plan to fleet formats, and certify the files as read back.

Files are written into a hidden folder, read back, verified against the plan, and moved to their
destination. An export that violates a limit after rounding or refitting is refused, and existing
files stay.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.checks.certifying import certificate_of, certify
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.drones.controllers import STOCK, Gains, Tube, stiffest_gains
from hitchopt.errors import (
    FileError,
    HitchoptError,
    InfeasibleError,
    InputError,
    OneLine,
    Progress,
    UnsupportedError,
    contained,
    rounded_up,
)
from hitchopt.exports.contents import (
    MANIFEST,
    MANIFEST_FORMAT,
    NOTE,
    PLAN_COPY,
    listed_names,
    read_manifest,
    sealed,
)
from hitchopt.exports.format import ExportTask, Format, FormatOutput, format_of, own_endings
from hitchopt.exports.held_tension import held_tension, loop_gains, trailing_times
from hitchopt.exports.options import HOMES, ExportOptions
from hitchopt.exports.placing import ReferenceFrame, placeholder_fleet, places_text, read_fleet
from hitchopt.exports.tension import TensionPolicy
from hitchopt.exports.verification import Flown, Verdict, verify
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.forces import SLACK
from hitchopt.motion.flight import REST_RATE, Flight
from hitchopt.motion.loads import (
    ellipsoid_notes,
    tracking_notes,
    tracking_warnings,
    weightless_notes,
)
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import SavedPlan, write_plan
from hitchopt.planners.candidates import outcome
from hitchopt.storage.files import digest, replace_files, write_strict_json
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.values import Array, alternatives
from hitchopt.values.fields import with_fields

RETRY_STRETCHES = (1.02, 1.05)  # Factors of durations if rounding violates a limit

REFIT_SHARES = (0.95, 0.8, 0.6, 0.3)
"""Fractions of the usual refit error of parts: the next one for each part that is refused."""

STRETCH_FACTORS = (1.0, 1.25, 1.5)  # Stretches that are tried, over the first one
MAX_STRETCH = 20.0  # Largest stretch that is tried
STREAM = "Stream it with format=ros2bag or hitchopt fly"  # Remedy if setpoints hold no tension
TUNED = {name for name, stock in STOCK.items() if math.isfinite(stock.stiffest[0])}
"""Controllers whose stiffest gains are known."""
OFFSETS_HOLD_TENSION = "none: the setpoint offsets hold the tension; feed nothing forward"
NO_CABLE_FORCE = "none: files with accelerations contain those of the drones"

TRAILING_REMEDY = "fly more slowly, use longer cables or larger polygons, or fly full setpoints"
"""Remedy for drones that trail positions."""

ROUNDING_REASON = "rounding or refitting errors exceed the plan's margins"
OFFSET_REASON = (
    "setpoints that hold the tension exceed the plan's margins: use stiffer position loops or a "
    "lower tension, stream the plan, or add allow_slack=True"
)
"""Reasons for violations, without and with setpoints that hold the tension."""


@dataclass(frozen=True)
class Export(OneLine):
    """Exported and verified files."""

    folder: Path
    files: tuple[str, ...]  # file names without the manifest
    verdict: Verdict  # errors and checks of the exported motion
    notes: tuple[str, ...]  # notes for the user
    begins: float = 0.0  # start of the part in the plan [s]
    goes_slack: bool = False  # whether nothing holds the tension of its cables

    @property
    def sources(self) -> dict[str, Path]:
        """Paths of the files and of the manifest, by name."""
        return {name: self.folder / name for name in (*self.files, MANIFEST)}


def export_plan(
    saved: SavedPlan,
    format: str,
    folder: Path,
    progress: Progress | None,
    options: Mapping[str, Any],
) -> tuple[Export, ...]:
    """Export a plan with keywords of ``ExportOptions``; see ``Plan.export``."""
    return export_flight(saved, ExportOptions(format, **options), folder, progress)


def export_flight(
    saved: SavedPlan,
    options: ExportOptions,
    folder: Path | str,
    progress: Progress | None = None,
    *,
    simulated: bool = False,
) -> tuple[Export, ...]:
    """Export a plan; return one export per part.

    A plan from a file is certified first, unless its files are only flown in simulation. Only files
    of an earlier export are replaced.

    Parameters
    ----------
    saved: the plan, with its title, the text of its problem and custom rules, if any.
    options: options of the export.
    folder: created if it is missing. A name with the suffix of the format's only file is that of
        the file, and the manifest is written next to it.
    progress: status callback.
    simulated: whether drones only fly the files in simulation.

    Raises CertificateError if the certificate does not hold, InputError for an invalid option, and
    InfeasibleError if the format cannot hold the plan, or violates a limit; nothing is written.
    """
    say = progress or (lambda _: None)
    flight = saved.flight
    kind = format_of(options.format)
    roles = flight.team.listed_names
    place = Path(folder)
    plan = flight.stretched(options.stretch)
    if options.rate is not None and kind.rate == 0.0:
        bound = f"omitted for {kind.name}"
        raise InputError("rate", options.rate, bound, "it does not sample")
    frame = ReferenceFrame(options.frame or kind.frames[0], options.origin, options.yaw)
    if frame.name not in kind.frames:
        bound = f"{alternatives(kind.frames)} for {kind.name}"
        raise InputError("frame", frame.name, bound, f"omit it for {kind.frames[0]}")
    if options.fleet is None:
        fleet = placeholder_fleet(roles, dotted=kind.dotted)
    else:
        fleet = read_fleet(options.fleet, roles)
    rate = kind.rate if options.rate is None else options.rate
    _check_gains(kind, flight.team, options)
    settings = kind.settings(flight.team, options)
    notes = list[str]()
    with contained("a note"):
        request = parse_yaml(saved.problem) if saved.problem else None
        notes += weightless_notes(flight, request)
        notes += ellipsoid_notes(flight, request)
        notes += _notes(kind, plan, options)
    if saved.stated_rules:
        names = ", ".join(rule.name for rule in saved.stated_rules)
        notes.append(f"custom rules are not recomputed in the export: {names}")
    content = plan, saved.title, frame, fleet, rate, options
    task = ExportTask(*content, settings=settings, notes=tuple(notes), has_trims=kind.has_heading)
    is_export = _is_file(place, kind) and place.with_name(f"{place.name}.{MANIFEST}").exists()
    if place.exists() and not (place.is_dir() or is_export):
        raise FileError(f"{place}: already exists; an export is a folder: choose another name")
    if not simulated:
        certificate_of(plan, say).raise_if_violated()
    with _scratch_folder(place) as scratch:
        copy = scratch / PLAN_COPY
        write_plan(copy, *saved)
        task = replace(task, plan_digest=digest(copy), stretch=options.stretch)
        task, exports = _export_task(kind, task, scratch, say)
        return _move_exports(exports, place, kind, task, copy)


def _notes(kind: Format, flight: Flight, options: ExportOptions) -> Iterator[str]:
    """Yield notes on tracking errors, losses, trims, velocities, and other plans in the air."""
    yield from tracking_warnings(flight)
    yield from tracking_notes(flight)
    if any(each.motion.requirements.limits.survive is not None for each in flight.teams):
        yield "files do not react to the loss of a robot: stream the plan with hitchopt fly"
    begin = float(flight.breaks[0])
    if kind.flown_by and np.max(np.abs(flight.drones.at(begin, 1))) > REST_RATE:
        yield "the plan begins in motion, as after a loss: only a stream continues with it"
    trim = 100.0 * float(np.max(np.linalg.norm(flight.team.trim, axis=1)))
    size = f"trims of drones, up to {trim:.3g} cm,"  # they turn with the heading
    if trim and kind.flown_by and kind.has_heading:
        yield f"setpoints include {size} for the heading in the files: keep this heading in flight"
    elif trim and kind.flown_by:
        yield f"{size} are not included: they turn with the heading, which {kind.name} lacks"
    if kind.velocity_settings and not options.positions_only:
        speed = largest_rate(flight.drones, 1).worst
        size = f"at up to {speed:.2g} m/s"
        policy = TensionPolicy.of(kind, flight, options)
        if all(policy.knows_stiffness(each.motion.team) for each in flight.teams):
            size = f"up to {speed * max(_lags(flight, options)):.2g} m at {speed:.2g} m/s"
        yield (
            f"velocities follow from the curves with {kind.velocity_settings}; without them drones "
            f"trail positions by v kd/kp, {size}: positions_only=True allows for it"
        )
    for each in flight.others:
        yield (
            f"certified next to {each.name}, which starts at t = "
            f"{each.motion.drones.breaks[0]:.4g} "
            "s of this plan: fly both on one clock"
        )


def _lags(flight: Flight, options: ExportOptions) -> tuple[float, float]:
    """Return the largest ``trailing_times`` [s] of a flight's drones, horizontal and vertical.

    Raises InputError if gains of a team are not known.
    """
    lags = list[Array]()
    for team in (each.motion.team for each in flight.teams):
        gains = loop_gains(team, options.stiffness, options.damping, "positions_only=True")
        lags.append(np.max(trailing_times(*gains, team.mass[:, None]), axis=0))
    level, _, upright = np.max(lags, axis=0).tolist()
    return level, upright


def _allowing_for_trailing(kind: Format, task: ExportTask) -> ExportTask:
    """Return the task with the check of distances of drones that follow positions alone.

    They trail by v kd/kp at a steady speed v, and by at most ``trailing_times``. That and the
    format's error add to the drones' own errors. InfeasibleError if distances do not allow for it,
    with a remedy.
    """
    if not task.options.positions_only:
        return task
    planned = task.without_offsets or task.flight
    lags = _lags(task.flight, task.options)
    speed = largest_rate(task.flight.drones, 1).worst
    own = Tube.enclosing(_own_errors(each.motion) for each in planned.teams) or Tube.of(None)

    def with_trailing(tube: Tube, fastest: float) -> Tube:
        """Return the errors of drones that fly up to a speed [m/s]."""
        level, height = (kind.accuracy + fastest * lag for lag in lags)
        return Tube(tube.level + level, tube.height + height)

    def check_at(stretch: float) -> Check:
        """Return the check of a plan that is flown slower by a factor."""

        def widened(motion: Motion) -> Motion:
            tube = with_trailing(_own_errors(motion), speed / stretch)
            wider = with_fields(motion.requirements.limits, tracking=tube)
            return motion.replaced(requirements=replace(motion.requirements, limits=wider))

        return certify(planned.each_team(widened))[TRACKING_RADIUS.name]

    check = check_at(1.0)
    size = f"trail them by v kd/kp, up to {speed * max(lags):.2g} m at {speed:.2g} m/s"
    if check.holds:
        note = f"distances allow for drones that follow positions alone and {size}"
        return replace(task, trailing=check, notes=(*task.notes, note))
    room = check.worst - own.level - kind.accuracy  # for trailing, of errors level
    first = math.ceil(101.0 * speed * lags[0] / room) / 100.0 if room > 0.0 else math.inf
    needed = with_trailing(own, max(speed, planned.requirements.limits.speed))  # of another plan
    needed = Tube(*(math.ceil(100.0 * x) / 100.0 for x in (needed.level, needed.height)))
    remedy = (
        f"Plan with limits.tracking: {_in_files(needed)} and team.quadrotor.tracking: "
        f"{_in_files(own)}, their errors with full setpoints"
    )
    for factor in STRETCH_FACTORS:
        if first * factor <= MAX_STRETCH and check_at(first * factor).holds:
            stretch = rounded_up(task.options.stretch * first * factor, 4)
            remedy = f"Add stretch={stretch:.4g}"
            break
    message = (
        f"{kind.name}: drones that follow positions alone {size}, more than distances allow for. "
        f"{remedy}, or omit positions_only and fly full setpoints."
    )
    raise InfeasibleError([check.violation("", TRAILING_REMEDY)], message)


def _own_errors(motion: Motion) -> Tube:
    """Return the tracking errors of a team's drones: as stated for each, or as allowed for."""
    stated = [kind.tracking for kind in motion.team.quadrotor if kind.tracking is not None]
    if len(stated) < len(motion.team.quadrotor):
        return motion.requirements.limits.tube
    return Tube.enclosing(map(Tube.of, stated)) or Tube.of(None)


def _in_files(tube: Tube) -> str:
    """Return tracking errors as a value in a problem file."""
    if tube.height <= tube.level:
        return f"{tube.level:g}"
    return f"{{level: {tube.level:g}, height: {tube.height:g}}}"


def _check_gains(kind: Format, team: Team, options: ExportOptions) -> None:
    """Raise InputError for gains that a format does not use, or that a named controller has."""
    if options.positions_only and not kind.flown_by:
        bound = f"omitted for {kind.name}"
        raise InputError("positions_only", True, bound, "its files are not flown")
    controllers = _controllers(team)
    is_used = kind.needs_stiffness or kind.has_gains
    is_used |= options.hold_tension or options.positions_only
    for option in ("stiffness", "damping"):
        if (value := getattr(options, option)) is None:
            continue
        if not is_used:
            bound = f"omitted for {kind.name} without hold_tension=True"
            raise InputError(option, value, bound, "add hold_tension=True")
        if controllers:
            bound = f"omitted with controller {controllers[0]}, whose gains are exported"
            raise InputError(option, value, bound, "set team.quadrotor.gains")


def _export_task(
    kind: Format, task: ExportTask, scratch: Path, say: Progress
) -> tuple[ExportTask, list[Export]]:
    """Export a task; return it with its offsets, if any.

    If tensions cannot be held, they are lost if ``allow_slack`` is set; otherwise InfeasibleError
    is raised, with a remedy.
    """
    policy = _policy(kind, task)
    may_lose = task.options.allow_slack
    if not policy.slack_reason:
        held = outcome(partial(_export_held, kind, task, policy, scratch / "held", say))
        if not isinstance(held, InfeasibleError):
            return held
        if not (policy.needs_offsets and may_lose):
            raise held
    elif not may_lose:
        remedy = _tried_remedy(kind, task, scratch / "remedy", say)
        message = f"{kind.name}: {policy.slack_reason} {remedy}, or add allow_slack=True."
        raise InfeasibleError([], message)
    return _export_as_held(kind, task, scratch / "slack", say)


def _export_held(
    kind: Format, task: ExportTask, policy: TensionPolicy, scratch: Path, say: Progress
) -> tuple[ExportTask, list[Export]]:
    """Export a task whose tensions a policy holds, with offsets if it needs them."""
    held = _with_offsets(task) if policy.needs_offsets else task
    return _export_as_held(kind, held, scratch, say)


def _policy(kind: Format, task: ExportTask) -> TensionPolicy:
    """Return how the tension of a task's cables is held."""
    return TensionPolicy.of(kind, task.flight, task.options)


def _with_offsets(task: ExportTask) -> ExportTask:
    """Return the task with setpoints whose offsets hold the tension."""
    moved = held_tension(task.flight, task.options.stiffness, task.options.damping)
    notes = (*task.notes, moved.note)
    return replace(task, flight=moved.flight, without_offsets=task.flight, notes=notes)


def _export_as_held(
    kind: Format, task: ExportTask, scratch: Path, say: Progress
) -> tuple[ExportTask, list[Export]]:
    """Export a task with its offsets, if any; return it with what it leaves undetermined."""
    task = _allowing_for_trailing(kind, task)
    reasons = _policy(kind, task).undetermined_reasons(has_offsets=task.holds_tension)
    task = replace(task, undetermined=reasons)
    return task, _first_valid(kind, task, scratch, say)


def _tried_remedy(kind: Format, task: ExportTask, scratch: Path, say: Progress) -> str:
    """Return the first change, in words, with which the export holds the tension."""
    for number, (words, changed) in enumerate(_remedies(kind, task)):
        with contextlib.suppress(InfeasibleError, InputError):
            settings = kind.settings(changed.flight.team, changed.options)
            trial = replace(changed, settings=settings)
            if not _policy(kind, trial).slack_reason:
                _export_task(kind, trial, scratch / str(number), say)
                return words
    return STREAM


def _remedies(kind: Format, task: ExportTask) -> Iterator[tuple[str, ExportTask]]:
    """Yield changes, in words, and the changed task."""
    policy = _policy(kind, task)
    teams = policy.teams
    if not any(map(_controllers, teams)) and not all(map(policy.knows_stiffness, teams)):
        stiffness = float(f"{kind.stiffest * min(np.min(team.mass) for team in teams):.3g}")
        options = replace(task.options, stiffness=stiffness)
        words = f"Add stiffness={stiffness:g}, whose gains are exported"
        if not kind.has_gains:
            words = f"Add the stiffness of the position loops, such as stiffness={stiffness:g}"
        yield words, replace(task, options=options)
    if policy.is_overridden:
        kinds = {kind for team in teams for kind in team.quadrotor}
        key = "gains.ki to 0" if all(kind.controller for kind in kinds) else "integral to false"
        yield f"Set team.quadrotor.{key} and solve again", _flown_by(task, _without_integral)
        only = next(iter(kinds))
        if len(kinds) == 1 and only.controller in TUNED:
            gains = stiffest_gains(only.mass, only.latency, only.controller)
            text = f"{gains}".replace("'", "")
            words = f"Set team.quadrotor.gains to {text} and solve again"
            yield words, _flown_by(task, lambda kind: with_fields(kind, gains=gains))


def _without_integral(kind: Quadrotor) -> Quadrotor:
    """Return a kind of drones whose position loop has no integral."""
    if kind.controller is None:
        return with_fields(kind, integral=False)
    return with_fields(kind, gains=replace(Gains.of(kind.gains), ki=0.0))


def _flown_by(task: ExportTask, change: Callable[[Quadrotor], Quadrotor]) -> ExportTask:
    """Return a task with other kinds of drones on its cables."""

    def changed(motion: Motion) -> Motion:
        if not motion.team.has_cables:
            return motion
        kinds = tuple(map(change, motion.team.quadrotor))
        return motion.replaced(team=with_fields(motion.team, quadrotor=kinds))

    return replace(task, flight=task.flight.each_team(changed))


def _controllers(team: Team) -> list[str]:
    """Return the names of the controllers of a team."""
    return sorted({name for each in team.quadrotor if (name := each.controller)})


def _first_valid(kind: Format, task: ExportTask, scratch: Path, say: Progress) -> list[Export]:
    """Export the plan as a whole, slower, or in parts: the first of these without violations."""
    refusals: list[InfeasibleError] = []
    tried: list[ExportTask] = []

    def candidates() -> Iterator[Sequence[ExportTask]]:
        yield (task,)
        # Further candidates are requested only after the whole was refused. Formats that round
        # points have several bounds; slower flights may pass their rounding
        is_rounded = len(kind.bounds) > 1 and not _exceeds_memory(refusals[0])
        for factor in RETRY_STRETCHES if is_rounded else ():
            slowdown = f"exported {factor - 1.0:.0%} slower than planned"
            note = f"{slowdown}: at full speed, rounding would break a limit"
            yield (replace(task.stretched(factor), notes=(*task.notes, note)),)
        yield from _cuts(kind, task, tried)

    def exported(tasks: Sequence[ExportTask], folder: Path) -> list[Export]:
        exports = list[Export]()
        for each in tasks:
            tried.append(each)
            exports.append(_export_part(kind, each, folder, say, refusals))
        return exports

    for number, tasks in enumerate(candidates()):
        exports = outcome(partial(exported, tasks, scratch / str(number)))
        if isinstance(exports, InfeasibleError):  # which _export_part adds to ``refusals``
            continue
        is_slower = number > 0 and len(tasks) == 1
        if not is_slower or certificate_of(tasks[0].plan).certified:
            return exports
    # Parts that fit in memory say more than the whole that does not
    raise next((each for each in refusals if not _exceeds_memory(each)), refusals[0])


def _cuts(
    kind: Format, task: ExportTask, tried: Sequence[ExportTask]
) -> Iterator[Sequence[ExportTask]]:
    """Yield a task cut into parts, of which the one that was tried last becomes more accurate.

    Smaller refit errors take more memory, so that this part becomes shorter.
    """
    refusals = Counter[float]()  # of parts, by their starts [s]
    spans = list[tuple[float, float]]()
    while True:
        refused = spans
        parts = kind.parts(task, lambda part: REFIT_SHARES[refusals[part.begins]])
        spans = [(part.begins, part.flight.duration) for part in parts]
        if parts and spans != refused:
            yield parts
        begins = tried[-1].begins
        refusals[begins] += 1
        if refusals[begins] == len(REFIT_SHARES):
            return


def _exceeds_memory(refusal: InfeasibleError) -> bool:
    return any(each.constraint == "memory" for each in refusal.violations)


def _written(kind: Format, folder: Path, task: ExportTask) -> FormatOutput:
    """Return what a format has written; raise UnsupportedError if another package's code fails."""
    try:
        return kind.write(folder, task)
    except (HitchoptError, OSError):
        raise
    except Exception as error:
        if kind.name in HOMES:
            raise  # a fault of hitchopt
        words = " ".join(f"{type(error).__name__}: {error}".split())
        raise UnsupportedError(f"the format {kind.name} failed to write: {words}") from error


def _verified_output(
    kind: Format,
    task: ExportTask,
    folder: Path,
    flown: Flown,
    violated: Set[str],
    say: Progress,
) -> tuple[FormatOutput, Verdict]:
    """Return what a format has written, and the verdict on what it reads back.

    Limits of some names, ``violated`` by earlier refits, are verified first. Raises InfeasibleError
    if any is violated.
    """
    written = _written(kind, folder, task)
    say(f"reading {kind.name} back")
    contents = kind.read(folder, task)
    rules = flown.rules
    for subset in filter(None, ([rule for rule in rules if rule.name in violated], rules)):
        verdict = verify(flown, contents, task.frame, task.names, subset, task.trims)
        if violations := verdict.violations(flown, kind.accuracy):
            reason = OFFSET_REASON if task.holds_tension else ROUNDING_REASON
            raise InfeasibleError(violations, f"{kind.name} is not written: {reason}")
    return written, verdict


def _export_part(
    kind: Format, task: ExportTask, place: Path, say: Progress, refusals: list[InfeasibleError]
) -> Export:
    """Export a part with the first refit that violates no limit, or raise InfeasibleError.

    Refusals are appended to ``refusals``. Limits that caused one are verified first.
    """
    folder = place / f"part{task.number}"
    folder.mkdir(parents=True)
    flown = Flown(task.flight, task.without_offsets, task.options.positions_only)
    for attempt, bound in enumerate(kind.bounds, 1):
        say(f"writing {kind.name}" + (f", attempt {attempt}" if attempt > 1 else ""))
        violated = {each.constraint for refusal in refusals for each in refusal.violations}
        refit = replace(task, bound=bound)
        verified = outcome(partial(_verified_output, kind, refit, folder, flown, violated, say))
        if isinstance(verified, InfeasibleError):
            refusals.append(verified)
            continue
        written, verdict = verified
        notes = (*written.notes, *task.notes, *task.undetermined)
        if task.trailing is not None:
            verdict = replace(verdict, checks=(*verdict.checks, task.trailing))
        receiver = {**task.settings, **written.receiver}
        feed_forward = OFFSETS_HOLD_TENSION if task.holds_tension else kind.feed_forward
        first = task.curves.coefficients[0, ..., 0] + task.trims
        offsets = task.frame.vectors(first - task.planned(0.0)).round(9)
        manifest = _manifest_head(kind, task) | {
            "heading_rad": task.frame.heading,
            "drones": {member.role: member.name for member in task.fleet.members},
            "addresses": {member.name: member.uri for member in task.fleet.members},
            "start_offsets": dict(zip(task.names, (offsets + 0.0).tolist(), strict=True)),
            "duration": verdict.duration,
            "plan_span": [task.begins, task.begins + task.flight.duration - task.rest],
            "position_error_m": asdict(verdict.position),
            "velocity_error_m_s": asdict(verdict.velocity),
            "checks": Certificate(verdict.duration, verdict.checks).to_dict()["checks"],
            "not_carried": verdict.not_carried,
            "feed_forward": feed_forward if task.flight.has_cables else NO_CABLE_FORCE,
            "undetermined_tension": list(task.undetermined),
            "tracking": _tracking_facts(task.flight),
            "notes": list(notes),
            "files": sorted(written.files),
            "digests": {name: digest(folder / name) for name in sorted(written.files)},
            **({"receiver": receiver} if receiver else {}),
        }
        write_strict_json(folder / MANIFEST, sealed(manifest))
        if NOTE not in written.files and (places := places_text(task.flight, task.fleet)):
            (folder / NOTE).write_text(_note(kind, task, places), "utf-8")
        goes_slack = any(SLACK in reason for reason in task.undetermined)
        return Export(folder, written.files, verdict, notes, task.begins, goes_slack)
    raise refusals[-1]


def _note(kind: Format, task: ExportTask, places: str) -> str:
    """Return README.txt of a format that has none of its own."""
    part = f"This is {task.part}.\n" if task.part else ""
    return (
        f"{task.title or 'A plan of hitchopt'}\n{part}\n"
        f"Files of the format {kind.name}, frame {task.frame.name}, {task.flight.duration:.3f} s. "
        f"{MANIFEST} has their errors,\nchecks and digests.\n{places}\n"
        "Run hitchopt lint on this folder before every flight.\n"
    )


def _tracking_facts(flight: Flight) -> dict[str, Any]:
    """Return the tracking errors [m] that distances allow for, those by gains, and warnings."""

    def by_team(tube_of: Callable[[Motion], Tube]) -> dict[str, Any]:
        return {each.name: asdict(tube_of(each.motion)) for each in flight.teams}

    return {
        "allowed_for_m": by_team(lambda motion: motion.requirements.limits.tube),
        "by_gains_m": by_team(lambda motion: Tube.of(motion.team.tracking)),
        "understated": list(tracking_warnings(flight)),
    }


def _manifest_head(kind: Format, task: ExportTask) -> dict[str, Any]:
    head: dict[str, Any] = {
        "format": MANIFEST_FORMAT,
        "exported_as": kind.name,
        "title": task.title,
    }
    names = _controllers(task.flight.team)
    head |= {"plan_digest": task.plan_digest, "stretch": task.stretch}
    return {**head, "flown_by": kind.flown_by, "controllers": names, **task.frame.to_dict()}


@contextlib.contextmanager
def _scratch_folder(place: Path) -> Iterator[Path]:
    """Create a hidden folder on the disk of a path for the context."""
    try:
        home = next(p for p in (place, *place.absolute().parents) if p.is_dir())
        with tempfile.TemporaryDirectory(prefix=".hitchopt-", dir=home) as folder:
            yield Path(folder)
    except OSError as error:
        raise FileError(f"{place}: cannot be written: {error.strerror or error}") from error


def _is_file(place: Path, kind: Format) -> bool:
    """Return whether a path is that of a single file, by its suffix."""
    suffix = place.suffix.lower()
    if not suffix or place.is_dir():
        return False
    return suffix in kind.endings or suffix in own_endings()


def _move_exports(
    exports: Sequence[Export], place: Path, kind: Format, task: ExportTask, plan: Path
) -> tuple[Export, ...]:
    """Move verified exports to their file or folder; several parts to subfolders.

    A folder gets the copy of the ``plan`` and README.txt, too. Raises FileError if files that are
    not of an earlier export would go.
    """
    first = exports[0]
    several = len(exports) > 1
    if _is_file(place, kind):
        if several or len(first.files) > 1 or Path(first.files[0]).suffix != place.suffix.lower():
            bound = f"a folder for {kind.name}, or a name with its only file's suffix"
            raise InputError("-o", str(place), bound, f"it writes {', '.join(first.files[:3])}")
        seal = f"{place.name}.{MANIFEST}"
        sources = {place.name: first.folder / first.files[0], seal: first.folder / MANIFEST}
        _move(place.parent, sources, set(sources), seal)
        return (replace(first, folder=place.parent, files=(place.name,)),)
    folders = [place / part.folder.name if several else place for part in exports]
    new = {folder: part.sources for part, folder in zip(exports, folders, strict=True)}
    for part, sources in zip(exports, new.values(), strict=True):
        if (note := part.folder / NOTE).exists():
            sources[NOTE] = note
    if several:
        ends = [*(part.begins for part in exports[1:]), task.timeline.duration]
        spans = [[part.begins, end] for part, end in zip(exports, ends, strict=True)]
        content = _manifest_head(kind, task) | {"duration": task.flight.duration, "files": []}
        content |= {"parts": [folder.name for folder in folders], "plan_spans": spans}
        new[place] = {MANIFEST: first.folder.parent / MANIFEST}
        write_strict_json(new[place][MANIFEST], sealed(content))
    new[place][plan.name] = plan
    parts = [place / name for name in listed_names(read_manifest(place), "parts")]
    obsolete = [folder for folder in parts if folder not in new]
    for folder, sources in (new | {folder: {} for folder in obsolete}).items():
        earlier = read_manifest(folder)
        owned = {MANIFEST, *listed_names(earlier, "files")}
        owned |= {PLAN_COPY, NOTE} if "plan_digest" in earlier else set()
        if foreign := [name for name in sources if name not in owned and (folder / name).exists()]:
            reason = "already exists and is not an export; choose another folder with -o"
            raise FileError(f"{folder / foreign[0]}: {reason}")
        _move(folder, sources, owned | {*sources}, MANIFEST)
    for folder in obsolete:
        with contextlib.suppress(OSError):  # not empty
            folder.rmdir()
    return tuple(replace(part, folder=f) for part, f in zip(exports, folders, strict=True))


def _move(folder: Path, sources: Mapping[str, Path], owned: set[str], seal: str) -> None:
    def move(path: Path) -> None:
        sources[path.name].rename(path)

    replace_files(folder, dict.fromkeys(sources, move), owned, seal)
