"""The command solve, and the group of all commands."""

from __future__ import annotations

import math
import shlex
import sys
import time
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from hitchopt.cli.failures import SafeGroup, complain, exit_code
from hitchopt.cli.output import hint, record, say
from hitchopt.cli.paths import GivenPath
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, TimeLimitError
from hitchopt.exports.export_options import checked_rate

if TYPE_CHECKING:
    from hitchopt.checks.certificate import Certificate
    from hitchopt.mission.loading import AnyProblem
    from hitchopt.mission.problem import Problem
    from hitchopt.mission.repair.change import Suggestion
    from hitchopt.motion.motion import Motion
    from hitchopt.plan import Plan

HELP = {"help_option_names": ["-h", "--help"], "show_default": True}
"""Settings of all commands' help texts."""

MODULES = {
    "abort": "abort_command",
    "calibrate": "calibrate_command",
    "check": "check_command",
    "export": "fleet_commands",
    "fit": "fit_command",
    "fly": "fly_command",
    "init": "init_command",
    "lint": "fleet_commands",
    "report": "view_commands",
    "simulate": "simulate_command",
    "statics": "statics_command",
    "sweep": "sweep_command",
    "verify": "verify_command",
    "view": "view_commands",
}
"""Where the other commands are; a module is imported when its command runs."""

MAX_ROWS = 5e8
"""Largest number of rows of setpoints.csv, about 100 GB: more is a typing error."""

DEFAULT_LIMIT = 600.0
"""Time limit of planning [s] unless --limit is given."""

MIN_SEARCH_TIME = 1e-3
"""Time limit of the search for changes [s] if no time is left: its end is then reported."""


def _version() -> str:
    try:
        return metadata.version("hitchopt")
    except metadata.PackageNotFoundError:
        return "(not installed)"


@click.group(cls=SafeGroup, modules=MODULES, context_settings=HELP)
@click.version_option(version=_version(), prog_name="hitchopt")
def main() -> None:
    """Plan how teams of quadrotors tie, reshape and untie polygonal cable hitches in midair.

    Every plan comes with a certificate that holds for all of continuous time.

    Exit codes: 0 done and certified; 2 the file or the usage is wrong in itself;
    3 well-formed, but it cannot be met, or its certificate fails; 130 and 143 ended by Ctrl-C and
    by SIGTERM, with no file half-written.

    Models are stored from run to run in the user's cache directory; the environment variable
    HITCHOPT_CACHE names another directory, or is off.
    """


@main.command()
@click.argument("file", type=GivenPath())
@click.option(
    "-o",
    "--output",
    "directory",
    metavar="DIR",
    type=GivenPath(),
    help="Directory to write the plan to; by default ./ and FILE's stem.",
)
@click.option("--rate", metavar="HZ", default=100.0, help="Setpoints per second and drone.")
@click.option("--report", is_flag=True, help="Write DIR/report.html as well.")
@click.option("--verify", is_flag=True, help="Prove the plan's limits by another method as well.")
@click.option(
    "--repair/--no-repair",
    "searching",
    default=True,
    help="If there is no plan, search for the smallest change that makes it feasible.",
)
@click.option(
    "--limit", metavar="SECONDS", default=DEFAULT_LIMIT, help="Time limit, searches included."
)
def solve(
    file: Path,
    directory: Path | None,
    rate: float,
    report: bool,
    verify: bool,
    searching: bool,
    limit: float,
) -> None:
    """Plan the problem in FILE, certify the plan and write it to DIR.

    FILE may be - for standard input. After a refusal DIR/previous has the last certified plan.
    """
    checked_rate(rate)
    if not math.isfinite(limit) or limit <= 0.0:
        raise InputError("--limit", limit, "above 0 s", f"{DEFAULT_LIMIT:g} s are usual")
    end = time.monotonic() + limit
    from hitchopt.cli.progress import LateProgress
    from hitchopt.mission.loading import parse_problem
    from hitchopt.mission.problem import Problem
    from hitchopt.storage.yaml_file import read_text

    place = _output(directory, file)
    if place.exists() and not place.is_dir():
        raise FileError(f"{place}: is not a directory; choose another one with -o")
    problem: AnyProblem | None = None
    try:
        text, name = read_text(file)  # once: it may be a pipe
        problem = parse_problem(text, name, file.parent)
        _check_rows(rate, _least_duration(problem), len(problem.team.drone_names))
        plan = _solve(problem, rate, limit)
        with LateProgress(sys.stderr, "writing") as progress:
            replace(plan, problem=text).save(place, rate, progress, report=report)
        record(directory=str(place))
        say(f"certified; the plan is in {place}")
        hint(_next_steps(place, plan.motion))
    except (InputError, FileError):
        raise  # nothing was solved: DIR stays as it is
    except HitchoptError as error:
        hitch = problem if isinstance(problem, Problem) else None
        searched = searching and not isinstance(error, TimeLimitError)
        left = max(end - time.monotonic(), MIN_SEARCH_TIME)
        _leave_diagnosis(place, error, hitch if searched else None, left)
    if verify:
        from hitchopt.cli.paths import plan_path
        from hitchopt.cli.verify_command import show_verified

        show_verified(plan_path(place))


def _output(directory: Path | None, file: Path) -> Path:
    """Return the directory to write to; refuse the root, which is named only by mistake."""
    if directory is None:
        return Path("stdin" if str(file) == "-" else file.stem)
    if not directory.name and directory.resolve().parent == directory.resolve():
        raise InputError("-o", str(directory), "a directory of its own", "name one, such as out")
    return directory


def _solve(problem: AnyProblem, rate: float, limit: float) -> Plan:
    """Return the plan, and show it."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.planning import solve as solved

    with LateProgress(sys.stderr, "planning", limit) as progress:
        plan = solved(problem, progress=progress, limit=limit)
    show_plan(plan.title, plan.motion, plan.certificate)
    _check_rows(rate, plan.motion.duration, len(problem.team.drone_names))
    return plan


def _next_steps(place: Path, motion: Motion) -> str:
    """Return what to do with a plan."""
    from hitchopt.exports.directory import SUMMARY

    name = shlex.quote(str(place))
    lines = [f"next: look at {place / SUMMARY}"]
    if motion.team.has_cables:
        lines.append(f"      hitchopt simulate {name}")
    # Edges that bend around an object need more digits than fitted polynomials keep.
    chosen = "crazyswarm2 --stretch 1.01" if motion.contacts is None else "csv"
    return "\n".join([*lines, f"      hitchopt export {name} --format {chosen}"])


def _leave_diagnosis(
    place: Path, error: HitchoptError, problem: Problem | None, left: float
) -> NoReturn:
    """Report and write why there is no plan, and exit with the error's code.

    If a problem is given, changes that make it feasible are searched for in the time ``left`` [s].
    """
    from hitchopt.exports.directory import DIAGNOSIS, diagnosis_content, save_diagnosis
    from hitchopt.storage.previous_set import PREVIOUS

    complain(error)  # first, in case the diagnosis cannot be written
    save_diagnosis(place, error)  # the search may be interrupted
    found: tuple[Suggestion, ...] = ()
    if problem is not None and isinstance(error, InfeasibleError):
        error, found = report_suggestions(problem, error, left)
        save_diagnosis(place, error, found)
    record(directory=str(place), diagnosis=diagnosis_content(error, found))
    kept = place / PREVIOUS
    if kept.is_dir():
        record(previous=str(kept))
    last = f"; the last certified plan is in {kept}" if kept.is_dir() else ""
    say(f"no plan; the diagnosis is in {place / DIAGNOSIS}{last}", err=True)
    click.get_current_context().exit(exit_code(error))


def report_suggestions(
    problem: Problem, error: InfeasibleError, left: float
) -> tuple[InfeasibleError, tuple[Suggestion, ...]]:
    """Return the verified changes that make the problem feasible, and report them.

    The error has a note if the time limit has ended the search.
    """
    from hitchopt.cli.progress import LateProgress
    from hitchopt.mission.repair.change import NO_CHANGE
    from hitchopt.mission.repair.suggest import find_suggestions
    from hitchopt.time_limit import time_left, time_limit

    found: tuple[Suggestion, ...] = ()
    with LateProgress(sys.stderr, "searching for changes that make it feasible", left) as progress:
        try:
            with time_limit(left):
                found = find_suggestions(problem, error, progress=progress)
                ended = time_left() <= 0.0
        except TimeLimitError:
            ended = True
    for suggestion in found:
        say(str(suggestion), err=True)
    if not found:
        say(NO_CHANGE, err=True)
    if ended:
        note = "the search for changes ended at the time limit (--limit)"
        say(note, err=True)
        error = InfeasibleError(error.violations, f"{error.note}\n{note}".strip())
    return error, found


def show_plan(title: str, motion: Motion, certificate: Certificate) -> None:
    """Report the phases and the certificate of a plan."""
    from hitchopt.cli.console_tables import certificate_table, phase_table

    record(
        title=title,
        phases=[
            {name: getattr(phase, name) for name in ("name", "step", "start", "end", "remark")}
            for phase in motion.phases
        ],
        certificate=certificate.to_dict(),
    )
    if title:
        say(title)
    say(f"{phase_table(motion.phases)}\n\n{certificate_table(certificate)}\n")


def _least_duration(problem: AnyProblem) -> float:
    """Return the sum of the steps' own durations [s], a lower bound of the plan's duration."""
    from hitchopt.mission.problem import Problem

    if not isinstance(problem, Problem):
        return problem.duration or 0.0
    return sum(step.given_duration or 0.0 for step in problem.mission)


def _check_rows(rate: float, duration: float, drones: int) -> None:
    rows = rate * duration * drones
    if rows > MAX_ROWS:
        bound = (
            f"at most {MAX_ROWS / (duration * drones):.3g} Hz for a plan of {duration:g} s "
            f"and {drones} drones (it would write {rows:.3g} rows)"
        )
        raise InputError("--rate", rate, bound, "lower it, or shorten the plan")
