"""Write a certified plan in fleets' formats, and certify the files as read back.

There is one path: files are written into a hidden folder, read back, verified against the plan, and
moved to their place. An export that loses a limit by its rounding or refitting is refused, and what
was there before stays. Drones are those of the files; vertices, legs and tensions are the plan's.
So every ``worst`` bounds what is flown, for all t, as in the plan's certificate.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Certificate, Check, worst_of
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF, RULES, certificate_of, check_of
from hitchopt.checks.rule import CheckRule
from hitchopt.checks.spans import ROUNDING, value_cache
from hitchopt.errors import FileError, InfeasibleError, InputError, OneLine, Violation
from hitchopt.exports.format import Format, Task, format_of
from hitchopt.exports.held_tension import held_tension
from hitchopt.exports.options import ENDINGS, ExportOptions, checked_rate
from hitchopt.exports.placing import ReferenceFrame, placeholder_fleet, read_fleet
from hitchopt.exports.recording import (
    MANIFEST,
    MANIFEST_FORMAT,
    Recording,
    held_until,
    listed,
    read_manifest,
)
from hitchopt.hitch import Team
from hitchopt.hitch.forces import undetermined_tension
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import JOINT, Group, Motion
from hitchopt.motion.retiming import between, stretched
from hitchopt.storage.files import digest, replace_files, write_strict_json
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array

Progress = Callable[[str], None]  # Function that is called with what is being done now

SLOWER = (1.02, 1.05)  # Factors of the durations of a plan that loses a limit by being rounded
SHARES = (1.0, 0.3)  # Shares of the usual refit error of parts, tried in this order
HELD = "none: the offsets of the set points hold the tension; nothing is to be fed forward"
FREE = "none: accelerations are the drones' own, where the files hold them"


@dataclass(frozen=True)
class Export(OneLine):
    """Files that were written and verified."""

    folder: Path  # where they are
    files: tuple[str, ...]  # names in it, without the manifest
    verdict: Verdict  # errors and checks of what the files say
    notes: tuple[str, ...]  # what else is to be known of them
    begins: float = 0.0  # when in the plan it begins [s]; 0 unless the plan was cut

    @property
    def sources(self) -> dict[str, Path]:
        """Paths of its files and of the manifest, by name."""
        return {name: self.folder / name for name in (*self.files, MANIFEST)}


def export_motion(
    motion: Motion,
    title: str,
    options: ExportOptions,
    folder: Path | str,
    progress: Progress | None = None,
) -> tuple[Export, ...]:
    """Write the plan with these options; return the exports, one per part.

    A plan that this process has not certified, as one from a file, is certified first. The folder
    is made if it is missing, and only files of an earlier export there are replaced; a name that
    ends as the format's only file does is that file, its manifest next to it.

    Parameters
    ----------
    motion, title, options: the plan, and how to write it.
    folder: where to write it.
    progress: called with the current stage of work.

    Raises
    ------
    CertificateError, InputError: the certificate does not hold, or an option is wrong.
    InfeasibleError: the format cannot hold the plan, or loses a limit. Nothing is written then.
    """
    say = progress or (lambda _: None)
    kind, roles, place = format_of(options.format), motion.team.drone_names, Path(folder)
    plan = stretched(motion, options.stretch)
    if options.rate is not None and kind.rate == 0.0:
        bound = f"left out for {kind.name}"
        raise InputError("rate", options.rate, bound, "it does not sample")
    frame = ReferenceFrame(options.frame or kind.frames[0], options.origin, options.yaw)
    if frame.name not in kind.frames:
        bound = f"one of {', '.join(kind.frames)} for {kind.name}"
        raise InputError("frame", frame.name, bound, f"leave it out for {kind.frames[0]}")
    task = Task(
        plan,
        title,
        frame,
        placeholder_fleet(roles, dotted=kind.dotted)
        if options.fleet is None
        else read_fleet(options.fleet, roles),
        kind.rate if options.rate is None else checked_rate(options.rate),
        options,
        undetermined=_undetermined(kind, motion, options),
        settings=kind.settings(motion.team, options),
        notes=tuple(
            f"certified beside {each.name}, which begins at t = {each.motion.drones.breaks[0]:.4g} "
            "s of this plan: fly both on one clock"
            for each in plan.others
        ),
    )
    _refuse_lost_pull(kind, motion, options)
    sealed = _is_file(place) and place.with_name(f"{place.name}.{MANIFEST}").exists()
    if place.exists() and not (place.is_dir() or sealed):
        raise FileError(f"{place}: is there already; an export is a folder, so name another")
    certificate_of(plan, say).raise_if_violated()
    if options.hold_tension:
        held = held_tension(plan, options.stiffness, options.damping)
        task = replace(task, motion=held.motion, unheld=plan, notes=(*task.notes, held.note))
    with _scratch(place) as scratch:
        return _put(_written(kind, task, scratch, say), place, kind, task)


def _refuse_lost_pull(kind: Format, motion: Motion, options: ExportOptions) -> None:
    """Raise InputError where a named controller would lose the cables' tension, or fly other gains.

    What controllers do that nobody names is unknown: there the files warn.
    """
    named = _controllers(motion.team)
    for option in ("stiffness", "damping"):
        if named and (value := getattr(options, option)) is not None:
            bound = f"left out with controller {named[0]}, whose gains are exported"
            raise InputError(option, value, bound, "set team.quadrotor.gains")
    pulled = [name for team in _hitched(motion) for name in _controllers(team)]
    if kind.flown_by == "upload" and pulled and not options.hold_tension:
        bound = f"given for {kind.name}, which carries no cable force to controller {pulled[0]}"
        remedy = "add it, or stream: hitchopt fly, or a format that carries the force"
        raise InputError("hold_tension", False, bound, remedy)


def _undetermined(kind: Format, motion: Motion, options: ExportOptions) -> tuple[str, ...]:
    """Return why the files leave the tension undetermined; nothing without a hitch."""
    reasons = list[str]()
    for team in _hitched(motion):
        fed_forward = kind.flown_by != "upload" and bool(np.all(team.feed_forward))
        known = options.stiffness is not None or bool(np.all(np.isfinite(team.stiffness)))
        unknown = kind.receiver_integral and not known
        reasons += undetermined_tension(
            integral=unknown or bool(np.any(np.isinf(team.integral))),
            feed_forward=fed_forward or options.hold_tension,
        )
    return tuple(dict.fromkeys(reasons))


def _hitched(motion: Motion) -> list[Team]:
    """Return the teams that ever form a hitch."""
    return [each.motion.team for each in motion.groups if np.any(each.motion.formed)]


def _controllers(team: Team) -> list[str]:
    """Return the names of a team's controllers."""
    return sorted({name for each in team.quadrotor if (name := each.controller)})


def _written(kind: Format, task: Task, scratch: Path, say: Progress) -> list[Export]:
    """Write the first that loses nothing of the whole, it slower, its parts; or raise."""
    refusals: list[InfeasibleError] = []

    def arrangements() -> Iterator[Sequence[Task]]:
        yield (task,)
        full = any(broken.constraint == "memory" for broken in refusals[0].violations)
        rounds = len(kind.bounds) > 1 and not full and not task.options.hold_tension
        for factor in SLOWER if rounds else ():
            slower = stretched(task.motion, factor)
            remark = (
                f"flown {factor - 1.0:.0%} slower than the plan: rounded, it would lose a limit"
            )
            yield (replace(task, motion=slower, notes=(*task.notes, remark)),)
        yield from filter(None, (kind.parts(task, share) for share in SHARES))

    for number, tasks in enumerate(arrangements()):
        with contextlib.suppress(InfeasibleError):
            done = [_part(kind, each, scratch / str(number), say, refusals) for each in tasks]
            whole_and_slower = number > 0 and len(tasks) == 1
            if not whole_and_slower or certificate_of(tasks[0].motion).certified:
                return done
    raise refusals[0]


def _part(
    kind: Format, task: Task, place: Path, say: Progress, refusals: list[InfeasibleError]
) -> Export:
    """Write the first refit that breaks no limit; else raise InfeasibleError.

    Every refusal is added to ``refusals``, whose limits are verified before all others.
    """
    folder = place / f"part{task.number}"
    folder.mkdir(parents=True)
    rules = PLACES if task.options.hold_tension else FLOWN
    for attempt, bound in enumerate(kind.bounds, 1):
        say(f"writing {kind.name}" + (f", attempt {attempt}" if attempt > 1 else ""))
        try:
            written = kind.write(folder, replace(task, bound=bound))
            say(f"reading {kind.name} back")
            recording = kind.read(folder, task)
            known = {broken.constraint for each in refusals for broken in each.violations}
            for chosen in filter(None, ([r for r in rules if r.name in known], rules)):
                verdict = verify(task.motion, recording, task.frame, task.names, chosen)
                if lost := verdict.violations(task.motion, kind.accuracy):
                    words = "what it rounds or refits costs more than the plan has left"
                    raise InfeasibleError(lost, f"{kind.name} is not written: {words}")
        except InfeasibleError as refusal:
            refusals.append(refusal)
            continue
        notes = (*written.notes, *task.notes, *task.undetermined)
        receiver = {**task.settings, **written.receiver}
        manifest = _head(kind, task) | {
            "heading_rad": task.frame.heading,
            "drones": {member.role: member.name for member in task.fleet.members},
            "duration": verdict.duration,
            "plan_span": [task.begins, task.begins + task.motion.duration],
            "position_error_m": asdict(verdict.position),
            "velocity_error_m_s": asdict(verdict.velocity),
            "checks": Certificate(verdict.duration, verdict.checks).to_dict()["checks"],
            "not_carried": verdict.not_carried,
            "feed_forward": _fed_forward(kind, task),
            "undetermined_tension": list(task.undetermined),
            "notes": list(notes),
            "files": sorted(written.files),
            "digests": {name: digest(folder / name) for name in sorted(written.files)},
            **({"receiver": receiver} if receiver else {}),
        }
        write_strict_json(folder / MANIFEST, manifest)
        return Export(folder, written.files, verdict, notes, task.begins)
    raise refusals[-1]


def _fed_forward(kind: Format, task: Task) -> str:
    """Return the manifest's entry on the cables' pull in the files."""
    if not task.motion.has_cables:
        return FREE
    return HELD if task.options.hold_tension else kind.feed_forward


def _head(kind: Format, task: Task) -> dict[str, Any]:
    head = {"format": MANIFEST_FORMAT, "exported_as": kind.name, "title": task.title}
    names = _controllers(task.motion.team)
    return {**head, "flown_by": kind.flown_by, "controllers": names, **task.frame.to_dict()}


@contextlib.contextmanager
def _scratch(place: Path) -> Iterator[Path]:
    """Yield a hidden folder on the disk of a place, which is gone after the block."""
    try:
        home = next(p for p in (place, *place.absolute().parents) if p.is_dir())
        with tempfile.TemporaryDirectory(prefix=".hitchopt-", dir=home) as folder:
            yield Path(folder)
    except OSError as error:
        raise FileError(f"{place}: cannot be written: {error.strerror or error}") from error


def _is_file(place: Path) -> bool:
    """Return whether a place is that of a single file."""
    return place.suffix.lower() in ENDINGS and not place.is_dir()


def _put(done: Sequence[Export], place: Path, kind: Format, task: Task) -> tuple[Export, ...]:
    """Move what was written and verified into its file or folder, parts into folders of theirs."""
    first, several = done[0], len(done) > 1
    if _is_file(place):
        if several or len(first.files) > 1 or Path(first.files[0]).suffix != place.suffix.lower():
            bound = f"a folder for {kind.name}, or a name that ends as its only file does"
            raise InputError("-o", str(place), bound, f"it writes {', '.join(first.files[:3])}")
        seal = f"{place.name}.{MANIFEST}"
        sources = {place.name: first.folder / first.files[0], seal: first.folder / MANIFEST}
        _move(place.parent, sources, set(sources), seal)
        return (replace(first, folder=place.parent, files=(place.name,)),)
    folders = [place / part.folder.name if several else place for part in done]
    moved = {folder: part.sources for part, folder in zip(done, folders, strict=True)}
    if several:
        ends = [*(part.begins for part in done[1:]), task.motion.duration]
        spans = [[part.begins, end] for part, end in zip(done, ends, strict=True)]
        content = _head(kind, task) | {"duration": task.motion.duration, "files": []}
        content |= {"parts": [folder.name for folder in folders], "plan_spans": spans}
        moved[place] = {MANIFEST: first.folder.parent / MANIFEST}
        write_strict_json(moved[place][MANIFEST], content)
    old = [
        place / name for name in listed(read_manifest(place), "parts") if place / name not in moved
    ]
    for folder, sources in (moved | {folder: {} for folder in old}).items():
        _move(folder, sources, _owned(folder, tuple(sources)), MANIFEST)
    for folder in old:  # it was cut into more
        with contextlib.suppress(OSError):  # not empty
            folder.rmdir()
    return tuple(replace(part, folder=here) for part, here in zip(done, folders, strict=True))


def _move(folder: Path, sources: Mapping[str, Path], owned: set[str], seal: str) -> None:
    def move(path: Path) -> None:
        sources[path.name].rename(path)

    replace_files(folder, dict.fromkeys(sources, move), owned, seal)


def _owned(folder: Path, files: Sequence[str]) -> set[str]:
    """Return the files of an earlier export and of the next one, which replaces no others."""
    owned = {MANIFEST, *listed(read_manifest(folder), "files")}
    if foreign := [name for name in files if name not in owned and (folder / name).exists()]:
        words = "is there already and not from an export; choose another folder with -o"
        raise FileError(f"{folder / foreign[0]}: {words}")
    return {*owned, *files}


FLOWN = tuple(rule for rule in RULES if any(evaluator.exported for evaluator in rule.evaluators))
"""Rules of the checks of the exported motion, in their order."""

PLACES = tuple(RULE_OF[name] for name in ("separation", "cable_clearance", "keep_out", "arena"))
"""Rules for set points that hold a tension. They are not where the drones are, of which the plan's
certificate says everything; but a drone whose cable breaks or goes slack flies there."""

EASIER = "fly it slower with stretch=, plan below the limit, or choose another format"
CLEARER = "plan with a wider margin there, sample at a higher rate=, or choose another format"
"""Remedies for checks that a slower flight eases, and for the others."""

NOT_CARRIED = (
    "acceleration, jerk, thrust and tilt: straight lines between samples, where velocity jumps",
    "jerk: acceleration jumps between pieces; thrust and tilt are those within the pieces",
    "a smooth jerk: it jumps between pieces",
)
"""Quantities that files do not carry, by the highest continuous derivative."""


@dataclass(frozen=True)
class Deviation:
    """The largest distance of exported curves from the plan's over all of the time."""

    worst: float  # [m] or [m/s], a bound for all t
    time: float  # [s], where it is about attained
    drone: str


@dataclass(frozen=True)
class Verdict:
    """Errors and checks of exported numbers."""

    duration: float  # of what is flown [s]
    position: Deviation  # from the plan [m]
    velocity: Deviation  # [m/s]
    checks: tuple[Check, ...]  # those of what is flown that the format carries
    not_carried: str  # what the format cannot carry, in words

    @property
    def lost(self) -> tuple[Check, ...]:
        """Checks that do not hold."""
        return tuple(check for check in self.checks if not check.holds)

    def violations(self, motion: Motion, accuracy: float) -> list[Violation]:
        """Return the limits that an export breaks; ``accuracy`` is the format's [m]."""
        violations = []
        for check in self.lost:
            rule = RULE_OF[check.name]
            planned = check_of(rule, motion, exported=True) or check
            values = f"{planned.bound:.6g}, the export loses {abs(check.bound - planned.bound):.3g}"
            when = f"at t = {check.time:.4g} s (the plan keeps {values})"
            violations.append(check.violation(when, EASIER if rule.derivative > 0 else CLEARER))
        worst, when = self.position.worst, f"at t = {self.position.time:.4g} s"
        if worst > accuracy:
            remedy = "choose another format, such as csv, or a higher rate= where it samples"
            where = (self.position.drone,)
            error = Violation("position_error", worst, accuracy, "max", "m", where, when, remedy)
            violations.append(error)
        return violations


def verify(
    motion: Motion,
    recording: Recording,
    frame: ReferenceFrame,
    names: Sequence[str],
    rules: Sequence[CheckRule] = FLOWN,
) -> Verdict:
    """Return errors and checks of a recording that stands for the plan ``motion``, from t = 0 on.

    The plan lies in ``frame``; ``names`` (D,) are what the files call its drones, in its order.
    FileError tells of drones that are not the plan's, or of less than all of its time.
    """
    missing = [name for name in names if name not in recording.names]
    if missing or len(recording.names) != len(names):
        reason = f"{missing[0]} is missing" if missing else "there are more of them"
        raise FileError(f"its drones are not those of the plan: {reason}")
    index = [recording.names.index(name) for name in names]
    firsts = np.cumsum([len(each.motion.team.drone_names) for each in motion.groups])[:-1]
    carried = [rule for rule in rules if rule.derivative <= recording.smooth + 1]
    checks: list[list[Check | None]] = []
    apart: list[list[Deviation]] = []
    end = 0.0
    for window in recording.windows():
        if abs(float(window.breaks[0]) - end) > JOINT:
            raise FileError(f"begins at t = {window.breaks[0]:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = frame.in_plan(window.alike(window.coefficients[:, index]))
        groups = list[Group]()
        for group, places in zip(
            motion.groups, np.split(curves.coefficients, firsts, axis=1), strict=True
        ):
            planned = _planned(group.motion, window.breaks)
            flown = on_breaks(curves.alike(places), planned.drones.breaks)
            apart.append(_deviations(flown, planned, group))
            groups.append(replace(group, motion=replace(planned, drones=flown)))
        written = combined(groups, [_at_window(each, window.breaks) for each in motion.others])
        with value_cache():
            checks.append([check_of(rule, written, exported=True) for rule in carried])
    if end < motion.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {motion.duration:g} s")
    position, velocity = (max(each, key=lambda d: d.worst) for each in zip(*apart, strict=True))
    worst = tuple(filter(None, map(worst_of, zip(*checks, strict=True))))
    return Verdict(end, position, velocity, worst, NOT_CARRIED[recording.smooth])


def _planned(motion: Motion, breaks: Array) -> Motion:
    """Return the plan over the span of ``breaks``, split there too; at rest after its end."""
    start, end = float(breaks[0]), float(breaks[-1])
    inner = motion.drones.breaks
    common = merged_breaks([breaks, inner[(inner > start) & (inner < end)]])

    def span(part: PiecewisePolynomial) -> PiecewisePolynomial:
        return on_breaks(held_until(part, end), common)

    last = motion.phases[-1:]
    phases = motion.phases[:-1] + tuple(replace(p, end=max(p.end, end)) for p in last)
    here = tuple(p for p in phases if p.end > start + JOINT and p.start < end - JOINT)
    return motion.map_curves(span, here)


def _at_window(other: Group, breaks: Array) -> Group:
    """Return a plan that flies besides over the span of ``breaks``."""
    return replace(other, motion=between(other.motion, float(breaks[0]), float(breaks[-1])))


def _deviations(flown: PiecewisePolynomial, motion: Motion, group: Group) -> list[Deviation]:
    """Return how far curves on the breaks of a plan are off, in position and in velocity."""
    degree, deviations = max(flown.degree, motion.drones.degree), []
    wanted = bernstein.elevate(motion.drones.coefficients, degree)
    apart = flown.alike(bernstein.elevate(flown.coefficients, degree) - wanted)
    for order, margin in enumerate((ROUNDING * float(np.max(np.abs(wanted))), 0.0)):
        most = largest_rate(apart, order)
        drone = group.label(motion.team.drone_names[most.item])
        deviations.append(Deviation(most.worst + margin, most.time, drone))
    return deviations
