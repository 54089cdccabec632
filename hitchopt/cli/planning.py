"""The commands solve, check and init: problem files to certified plans."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

import hitchopt as ho
from hitchopt.cli.failures import exit_code, report_error
from hitchopt.cli.options import (
    PATH,
    SUFFIXES,
    command,
    completing,
    option,
    plan_path,
    width_option,
)
from hitchopt.cli.output import (
    ProgressBar,
    output,
    record,
    say,
    show_notes,
    show_places,
    show_plan,
    span_text,
)
from hitchopt.errors import (
    FileError,
    HitchoptError,
    InfeasibleError,
    InputError,
    TimeLimitError,
    contained,
)
from hitchopt.mission import MAX_SUGGESTIONS, NO_CHANGE
from hitchopt.slices import hooks, provided
from hitchopt.tables import table

if TYPE_CHECKING:
    from hitchopt.motion.flight import Flight

MIN_SEARCH_TIME = 1e-3  # Minimum time limit of the search for changes [s]
SEARCH_ENDED = "the search for changes ended at the time limit (--limit)"

PACKAGE = Path(ho.__file__).parent
# Templates other than the default, in PACKAGE
KINDS = {"carry": "mission/template_carry.yaml", "swarm": "mission/template_swarm.yaml"}
# File name of the schema for editors, and the line of problem files that refers to it
SCHEMA = "problem.schema.json"
MODELINE = f"# yaml-language-server: $schema={SCHEMA}\n"


@command(
    "file FILE",
    option("-o --output", "Output directory; default: ./ and the stem of FILE.", PATH, "DIR"),
    option("--rate", "Setpoints per second for each drone.", 100.0, "HZ"),
    option("--report", "Write DIR/report.html as well."),
    option("--no-picture", "Skip DIR/summary.png, as -q does."),
    option(
        "--repair/--no-repair",
        "If there is no plan, search for the smallest change that helps.",
        True,
    ),
    option("--repair-to", "Write FILE with a suggested change to this file.", PATH, "FILE"),
    option("--take", "Number of the change that --repair-to writes.", 1, "N"),
    option("--limit", "Time limit, searches included.", 600.0, "SECONDS"),
)
def solve(
    file: Path,
    output: Path | None,
    rate: float,
    limit: float,
    repair_to: Path | None,
    take: int,
    *,
    report: bool,
    no_picture: bool,
    repair: bool,
) -> None:
    """Plan the problem in FILE, certify the plan and write it to DIR.

    FILE may be - for standard input. If there is no plan, DIR/previous has the last certified plan.
    """
    from hitchopt.mission.loading import parse_problem
    from hitchopt.motion.states import checked_rate
    from hitchopt.storage.yaml_file import located, read_text
    from hitchopt.values import integer, positive

    checked_rate(rate)
    integer("take", take, 1, MAX_SUGGESTIONS)
    if take > 1 and repair_to is None:
        raise InputError("take", take, "used with --repair-to", "name a file to write")
    positive("limit", limit)
    end = time.monotonic() + limit
    folder = _output(output, file)
    if repair_to is not None:
        _write_new(str(repair_to), None)  # before the search, not after it
    problem: ho.Problem | None = None
    try:
        text, name = read_text(file)  # once: it may be a pipe
        problem = parse_problem(text, name, file.parent)
        has_places = problem.kind != "teams"  # else keys are relative to a team
        with located(text, name) if has_places else contextlib.nullcontext():
            plan = _plan(problem, text, folder, rate, limit, report=report)
    except (InputError, FileError):
        raise  # nothing was solved: DIR stays as it is
    except HitchoptError as error:
        for each in () if problem is None else problem.teams.values():
            if warning := each.requirements.understated_tracking(each.team):
                say(f"note: {each.name}: {warning}" if each.name else f"note: {warning}")
        is_searched = repair and not isinstance(error, TimeLimitError)
        seconds = max(end - time.monotonic(), MIN_SEARCH_TIME)
        edited = None if repair_to is None else (text, repair_to, take)
        _leave_diagnosis(folder, error, problem if is_searched else None, seconds, edited)
    show_notes(plan)
    for mission in problem.teams.values():
        stated, used = (math.degrees(x.limits.tilt) for x in (problem, mission.requirements))
        if used < stated:
            team = f"{mission.name}: " if mission.name else ""
            words = f"limits.tilt_deg is {stated:g}, but the controllers tilt by at most {used:g}"
            say(f"note: {team}{words}: planned for {used:g}")
    if not no_picture:
        _draw(plan, folder)


def _draw(plan: ho.Plan, folder: Path) -> None:
    """Draw the picture of a saved plan, unless ``--quiet``; a failure is only a warning."""
    if output().quiet:
        return
    with contained("summary.png"), ProgressBar("drawing"):
        plan.draw(folder)


def _output(option: Path | None, file: Path) -> Path:
    """Return the output directory; raises an error if it is the root or not writable."""
    folder = Path("stdin" if str(file) == "-" else file.stem) if option is None else option
    if option is not None and not option.name and option.resolve().parent == option.resolve():
        raise InputError("output", str(option), "a separate directory", "name one, such as out")
    home = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not (home.is_dir() and os.access(home, os.W_OK)):
        reason = "is not a writable directory; choose another one with -o"
        raise FileError(f"{folder}: {home} {reason}")
    return folder


def _plan(
    problem: ho.Problem, text: str, folder: Path, rate: float, limit: float, *, report: bool
) -> ho.Plan:
    """Plan, show and write a problem; return its plan."""
    from hitchopt.directory import certificate_content
    from hitchopt.motion.loads import tracking_notes
    from hitchopt.storage.archive import PLAN

    with ProgressBar("planning", limit) as progress:
        plan = replace(ho.solve(problem, progress=progress, limit=limit), problem=text)
    show_plan(plan.title, plan.flight, plan.certificate)
    show_places(plan.flight)
    for each in plan.flight.teams:
        _show_models(each.motion.team)
    _show_vertex_errors(plan.flight)
    with contained("a note on tracking"):
        for note in tracking_notes(plan.flight):
            say(f"note: {note}")
    with ProgressBar("writing") as progress:
        plan.save(folder, rate, progress, report=report)
    content = certificate_content(plan.flight, plan.certificate, folder / PLAN)
    say(f"certified; the plan is in {folder}", directory=str(folder), certificate=content)
    return plan


def _show_vertex_errors(flight: ho.Flight) -> None:
    """Report the largest errors of each team's vertices at rest, with their causes."""
    from hitchopt.checks.vertex_errors import error_in_words

    for each in flight.teams:
        if error := error_in_words(each.motion):
            say(f"{each.name}: {error}" if each.name else error)


def _show_models(team: ho.Team) -> None:
    """Report the models of a team's drones, and the tensions of their cables."""
    kinds = [kind.uncalibrated for kind in team.kinds]
    for kind in sorted({kind for kind in kinds if kind.model}, key=repr):
        robots = sorted({i // 2 for i, each in enumerate(kinds) if each == kind})
        pulls = span_text(team.tension[robots], ".3g") if team.has_cables else ""
        limit, binding = kind.usual_pull
        cables = f"; tension {pulls} N ({binding} allows {limit:.3g} N)"
        thrust = f"thrust {kind.max_thrust:.3g} N{cables if pulls else ''}"
        say(f"{kind.model}: {1e3 * kind.mass:.3g} g, {thrust}")


def _leave_diagnosis(
    folder: Path,
    error: HitchoptError,
    problem: ho.Problem | None,
    seconds: float,
    repair_to: tuple[str, Path, int] | None,
) -> NoReturn:
    """Report and save the diagnosis of an error, and exit with its code.

    Changes that make the problem, if any, feasible are searched for in the remaining time
    ``seconds`` [s]. The problem's text with one change is written to a file: ``repair_to`` is the
    text, the file and the number of the change.
    """
    from hitchopt.directory import diagnosis_content, save_diagnosis
    from hitchopt.storage.files import DIAGNOSIS, PREVIOUS

    report_error(error)  # first, in case the diagnosis cannot be written
    content = diagnosis_content(error)
    save_diagnosis(folder, content)  # the search may be interrupted
    if problem and problem.kind == "hitch" and isinstance(error, InfeasibleError):
        suggestions, note = _suggestions(problem, error, seconds)
        if note:
            error = error.with_note(note)
        content = diagnosis_content(error, [each.to_dict() for each in suggestions])
        save_diagnosis(folder, content)
        if repair_to and suggestions:
            _write_changed(*repair_to, suggestions)
    message = f"no plan; the diagnosis is in {folder / DIAGNOSIS}"
    if content.get("suggestions") and not repair_to:
        message += "; --repair-to FILE writes the problem with the first change"
    if (previous := folder / PREVIOUS).is_dir():
        record(previous=str(previous))
        message += f"; the last certified plan is in {previous}"
    say(message, err=True, directory=str(folder), diagnosis=content)
    click.get_current_context().exit(exit_code(error))


def _write_changed(text: str, path: Path, take: int, suggestions: Sequence[Any]) -> None:
    """Write a problem's text with the suggestion numbered ``take``, from 1, if it exists."""
    if take > len(suggestions):
        say(f"{path} is not written: there is no suggestion {take} (--take)", err=True)
        return
    changed = provided("changed_text")(text, suggestions[take - 1].change.edits)
    file = _write_new(str(path), changed)
    ordinal = ("first", "second", "third")[take - 1]
    say(f"wrote {file}, with the {ordinal} change", err=True, file=str(file))


def _suggestions(
    problem: ho.Problem, error: InfeasibleError, seconds: float
) -> tuple[tuple[Any, ...], str]:
    """Report and return changes that make the problem feasible, and a note on the time limit."""
    from hitchopt.errors import time_left, time_limit

    suggestions: tuple[Any, ...] = ()
    note = SEARCH_ENDED
    with (
        ProgressBar("searching for changes that make it feasible", seconds) as progress,
        contextlib.suppress(TimeLimitError),
        time_limit(seconds),
    ):
        for find in hooks("suggestions"):
            suggestions = find(problem, error, progress=progress)
        note = SEARCH_ENDED if time_left() <= 0.0 else ""
    say("\n".join([*map(str, suggestions or (NO_CHANGE,)), *([note] if note else [])]), err=True)
    return suggestions, note


@command(
    "directory DIR",
    option("--closest", "Report the closest pairs of drones over time."),
    option("--picture", "Draw them to a .png, .svg or .pdf file.", PATH, "FILE"),
    width_option("the picture"),
    option(
        "--gamma",
        "For tracking_radius: ratio of vertex errors to drone errors.",
        1.0,
        "FLOAT",
    ),
)
def check(
    directory: Path,
    picture: Path | None,
    width: float | None,
    gamma: float,
    *,
    closest: bool,
) -> None:
    """Recompute the certificate of the plan in DIR, or of a plan.npz, from its polynomials only."""
    from hitchopt.directory import (
        certificate_content,
        certificate_differences,
        changed_tables,
    )
    from hitchopt.plan import read_requested_plan

    path = plan_path(directory)
    saved = read_requested_plan(path)
    flight = saved.flight
    with ProgressBar("certifying") as progress:
        certificate = ho.certify(saved, progress, gamma)
    show_plan(saved.title, flight, certificate)
    _show_vertex_errors(flight)
    content = certificate_content(flight, certificate, path)
    record(certificate=content)
    if closest or picture is not None:
        with ProgressBar("finding the closest neighbours"):
            neighbours = ho.closest(ho.Plan(flight, certificate), picture=picture, width=width)
        say(f"Closest neighbours\n{neighbours}\n", closest=str(neighbours).splitlines())
        if picture is not None:
            say(f"drew the closest neighbours over time to {picture}")
    certificate.raise_if_violated()
    reason = "differs from the table that was written with the certificate; solve again"
    changed = [f"{path.with_name(name)}: {reason}" for name in changed_tables(path.parent)]
    changed += certificate_differences(path.parent, content)
    if changed := [*_changed_others(flight, path), *changed]:
        raise InfeasibleError((), "\n".join(changed))
    stated = ", ".join(rule.name for rule in certificate.not_recomputed)
    say(f"certified; recomputed from {path}" + (f", but not {stated}" if stated else ""))
    show_notes(ho.Plan(flight, certificate, problem=saved.problem))


def _changed_others(flight: Flight, path: Path) -> Iterator[str]:
    """Yield messages on other plans in ``others`` that are missing or have changed.

    Their paths are relative to the working directory, the plan's directory, or its parent.
    """
    from hitchopt.motion.plan_file import is_of

    for each in flight.others:
        folders = Path(), path.parent, path.parent.parent
        files = [file for folder in folders if (file := plan_path(folder / each.plan)).is_file()]
        if not any(is_of(each, file) for file in files):
            state = f"{files[0]} is a different plan" if files else "its plan is missing"
            yield f"others: {each.name} ({each.plan}): {state}; solve again with the current plan"


def example_files() -> list[Path]:
    """Return the examples of the installed package or the checkout that need no other plan."""
    installed = PACKAGE / "examples"
    folder = installed if installed.is_dir() else PACKAGE.parent / "problems"
    files = sorted([*folder.glob("*.yaml"), *(folder / "swarms").glob("*.yaml")])
    return [path for path in files if "\nothers:" not in path.read_text("utf-8")]


@command(
    "name [NAME]",
    option(
        "--example",
        "Write this example.",
        str,
        "EXAMPLE",
        **completing(lambda: [path.stem for path in example_files()]),
    ),
    option("--list listing", "List the examples."),
    option(
        "--kind",
        "Write a problem that carries an object, or a problem of single drones.",
        None,
        choices=[*KINDS],
    ),
    option(
        "--drone model",
        "Write a problem whose lengths, distances and tension fit a drone model, such as "
        "crazyflie_2.1; default: paper_132g.",
        str,
        "MODEL",
    ),
    option(
        "--robots",
        "Write a problem for this number of robots, 3 to 12, of two drones each; default: 3.",
        int,
        "N",
    ),
    option(
        "--schema",
        "Write problem.schema.json, which editors use to complete and check problem files.",
    ),
    type=str,
    required=False,
)
def init(
    name: str | None,
    example: str | None,
    model: str | None,
    kind: str | None,
    robots: int | None,
    *,
    listing: bool,
    schema: bool,
) -> None:
    """Write a commented problem file to start from, or an example.

    NAME defaults to problem.yaml, or to the name of the example.
    """
    if schema:
        _write_schema()
        return
    examples = {path.stem: path for path in example_files()}
    if listing:
        rows = [{"name": stem, "title": _title(path)} for stem, path in examples.items()]
        say(table("Examples", rows), examples=rows)
        return
    _check_choices(example, kind, model, robots, [*examples])
    template = PACKAGE / (KINDS[kind] if kind else "mission/template.yaml")
    source = examples[example] if example else template
    text = problem_text(source)
    if name is None:
        name = example or "problem"
    if model is None and robots is None:
        path = _write_new(name, text)
    else:
        path = _write_fitted(name, text, model, robots)
    say(f"wrote {path}; try: hitchopt solve {path}", file=str(path))
    recording = source.with_suffix(".csv")
    if recording.is_file():
        copy = _write_new(str(path.with_suffix(".csv")), recording.read_text("utf-8"), (".csv",))
        say(f"wrote {copy}: a recording of its simulated flight", recording=str(copy))


def _write_schema() -> None:
    """Write the schema of problem files for editors."""
    from hitchopt.mission.loading import problem_schema

    text = json.dumps(problem_schema(), indent=2, ensure_ascii=False)
    Path(SCHEMA).write_text(f"{text}\n", encoding="utf-8")
    hint = "keep it next to your problem files: their first line points editors to it"
    say(f"wrote {SCHEMA}; {hint}", file=SCHEMA)


def _check_choices(
    example: str | None,
    kind: str | None,
    model: str | None,
    robots: int | None,
    examples: Sequence[str],
) -> None:
    """Raise InputError for an unknown example, or for choices that exclude one another."""
    from hitchopt.values import closest_word

    if example is not None and example not in examples:
        remedy = closest_word(example, examples, "hitchopt init --list names them")
        raise InputError("example", example, "an example's name", remedy)
    choices = {"example": example, "kind": kind, "drone": model, "robots": robots}
    stated = [key for key, value in choices.items() if value is not None]
    if len(stated) > 1 and stated[0] != "drone":  # a model and a number of robots go together
        bound = f"omitted with --{stated[0]}"
        raise InputError(f"--{stated[1]}", choices[stated[1]], bound, "use only one of the two")


def _write_fitted(name: str, text: str, model: str | None, robots: int | None) -> Path:
    """Write a problem that fits a drone model and a number of robots, and say what fits them."""
    from hitchopt.mission.template import for_team

    fitted = for_team(text, model, robots)
    path = _write_new(name, fitted.text)
    _show_models(ho.load_problem(path).team)
    lengths = _range_text(fitted.lengths, "m")
    tensions = _range_text(fitted.tensions, "N")
    say(f"cables of {lengths} and tensions of {tensions} fit {fitted.polygon}")
    return path


def _range_text(ends: tuple[float, float], unit: str) -> str:
    """Return a range with its unit in words."""
    smallest, largest = (f"{end:.3g}" for end in ends)
    return (
        f"{smallest} {unit} or more" if math.isinf(ends[1]) else f"{smallest} to {largest} {unit}"
    )


def _title(path: Path) -> str:
    title = re.search(r"^title: (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return title.group(1).strip("'\"") if title else ""


def problem_text(path: Path) -> str:
    """Return the text of a problem file with its modeline and the filled-in template."""
    from hitchopt.mission.template import expand_sections

    return MODELINE + expand_sections(path.read_text(encoding="utf-8"))


def _write_new(name: str, text: str | None, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Write text, if any, to a new file with one of the suffixes; raises FileError if it exists."""
    path = Path(name)
    if not path.name.strip("."):
        raise FileError(f"{name!r}: is not a file name; use one, such as problem.yaml")
    if path.suffix not in suffixes:
        path = path.with_name(path.name + suffixes[0])
    if os.path.lexists(path):
        raise FileError(f"{path}: exists already; use another name, or remove it")
    if text is not None:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    return path
