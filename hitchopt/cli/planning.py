"""The commands solve, check, verify and init: problem files to certified plans."""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

import hitchopt as ho
from hitchopt.cli.failures import exit_code, exit_infeasible, report_error
from hitchopt.cli.options import PATH, command, completing, option, plan_path
from hitchopt.cli.output import ProgressBar, record, say, show_plan, span_text, table
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, TimeLimitError
from hitchopt.exports.options import checked_rate

if TYPE_CHECKING:
    from hitchopt.live.lost import Lost
    from hitchopt.mission.teams_problem import AnyProblem
    from hitchopt.motion.motion import Motion

SUFFIXES = (".yaml", ".yml")  # Endings of the names of problem files
# Time limit of the search for changes [s] if no time is left: its end is then reported
MIN_SEARCH_TIME = 1e-3
ENDED = "the search for changes ended at the time limit (--limit)"

PACKAGE = Path(ho.__file__).parent
STUDY = "study"
KINDS = ("carry", "swarm", STUDY)  # Templates besides that of a hitch which is tied
# The schema with which editors complete and check problem files beside it, and the line of such
# files that names it to them
SCHEMA = "problem.schema.json"
MODELINE = f"# yaml-language-server: $schema={SCHEMA}\n"


@command(
    "file FILE",
    option(
        "-o --output", "Directory to write the plan to; by default ./ and FILE's stem.", PATH, "DIR"
    ),
    option("--rate", "Setpoints per second and drone.", 100.0, "HZ"),
    option("--report", "Write DIR/report.html as well."),
    option("--verify", "Prove the plan's limits by another method as well."),
    option(
        "--repair/--no-repair",
        "If there is no plan, search for the smallest change that helps.",
        True,
    ),
    option(
        "--repair-to", "Write FILE with the first change that helps to this file.", PATH, "FILE"
    ),
    option("--limit", "Time limit, searches included.", 600.0, "SECONDS"),
)
def solve(
    file: Path,
    output: Path | None,
    rate: float,
    limit: float,
    repair_to: Path | None,
    *,
    report: bool,
    verify: bool,
    repair: bool,
) -> None:
    """Plan the problem in FILE, certify the plan and write it to DIR.

    FILE may be - for standard input. After a refusal DIR/previous has the last certified plan.
    """
    from hitchopt.mission.loading import parse_problem
    from hitchopt.storage.yaml_file import located, read_text
    from hitchopt.values import positive

    checked_rate(rate)
    positive("limit", limit)
    end = time.monotonic() + limit
    place = _output(output, file)
    if repair_to is not None:
        _write_new(str(repair_to), None)  # before the search, not after it
    problem: AnyProblem | None = None
    try:
        text, name = read_text(file)  # once: it may be a pipe
        problem = parse_problem(text, name, file.parent)
        one = not isinstance(problem, ho.TeamsProblem)  # else keys are those of a team alone
        with located(text, name) if one else contextlib.nullcontext():
            _plan(problem, text, place, rate, limit, report=report)
    except (InputError, FileError):
        raise  # nothing was solved: DIR stays as it is
    except HitchoptError as error:
        searched = repair and not isinstance(error, TimeLimitError)
        left = max(end - time.monotonic(), MIN_SEARCH_TIME)
        mended = None if repair_to is None else (text, repair_to)
        _leave_diagnosis(place, error, problem if searched else None, left, mended)
    if verify:
        _show_verified(plan_path(place))


def _output(given: Path | None, file: Path) -> Path:
    """Return the directory to write to; refuse the root, which is named only by mistake."""
    place = Path("stdin" if str(file) == "-" else file.stem) if given is None else given
    if given is not None and not given.name and given.resolve().parent == given.resolve():
        raise InputError("output", str(given), "a directory of its own", "name one, such as out")
    home = next(each for each in (place, *place.absolute().parents) if each.exists())
    if not (home.is_dir() and os.access(home, os.W_OK)):
        words = "is not a directory that may be written to; choose another one with -o"
        raise FileError(f"{place}: {home} {words}")
    return place


def _plan(
    problem: AnyProblem, text: str, place: Path, rate: float, limit: float, *, report: bool
) -> None:
    """Plan, show and write a problem."""
    from hitchopt.exports.directory import certificate_content
    from hitchopt.storage.archive import PLAN

    with ProgressBar("planning", limit) as progress:
        plan = ho.solve(problem, progress=progress, limit=limit)
    show_plan(plan.title, plan.motion, plan.certificate)
    for group in plan.motion.groups:
        _show_models(group.motion.team)
    with ProgressBar("writing") as progress:
        replace(plan, problem=text).save(place, rate, progress, report=report)
    content = certificate_content(plan.motion, plan.certificate, place / PLAN)
    say(f"certified; the plan is in {place}", directory=str(place), certificate=content)


def _show_models(team: ho.Team) -> None:
    """Say what is known of the team's models, and how hard their cables pull."""
    for kind in sorted({kind for kind in team.quadrotor if kind.model}, key=repr):
        of_robots = [each == kind for each in team.quadrotor]
        pulls = span_text(team.tension[of_robots], ".3g") if team.has_cables else ""
        most, binding = kind.usual_pull
        words = f"; cables pull {pulls} N, of {most:.3g} N held level by {binding}" if pulls else ""
        say(f"{kind.model}: {1e3 * kind.mass:.3g} g, thrust {kind.max_thrust:.3g} N{words}")


def _leave_diagnosis(
    place: Path,
    error: HitchoptError,
    problem: AnyProblem | None,
    left: float,
    mended: tuple[str, Path] | None,
) -> NoReturn:
    """Report and write why there is no plan, and exit with the error's code.

    If a problem is given, changes that make it feasible are searched for in the time ``left`` [s].
    The first one is made in the text of ``mended``, and written to its file.
    """
    from hitchopt.exports.directory import DIAGNOSIS, diagnosis_content, save_diagnosis
    from hitchopt.storage.files import PREVIOUS

    report_error(error)  # first, in case the diagnosis cannot be written
    content = diagnosis_content(error)
    save_diagnosis(place, content)  # the search may be interrupted
    if isinstance(problem, ho.Problem) and isinstance(error, InfeasibleError):
        suggestions, note = _suggestions(problem, error, left)
        if note:
            error = InfeasibleError(error.violations, f"{error.note}\n{note}".strip())
        content = diagnosis_content(error, [each.to_dict() for each in suggestions])
        save_diagnosis(place, content)
        if mended and suggestions:
            from hitchopt.mission.changes import with_edits_in

            written = _write_new(
                str(mended[1]), with_edits_in(mended[0], suggestions[0].change.edits)
            )
            say(f"wrote {written}, with the first change", err=True, file=str(written))
    message = f"no plan; the diagnosis is in {place / DIAGNOSIS}"
    if (previous := place / PREVIOUS).is_dir():
        record(previous=str(previous))
        message += f"; the last certified plan is in {previous}"
    say(message, err=True, directory=str(place), diagnosis=content)
    click.get_current_context().exit(exit_code(error))


def _suggestions(
    problem: ho.Problem, error: InfeasibleError, left: float
) -> tuple[tuple[ho.Suggestion, ...], str]:
    """Report the verified changes that make the problem feasible, and why the search ended."""
    from hitchopt.errors import time_left, time_limit
    from hitchopt.mission.repair import NO_CHANGE, find_suggestions

    suggestions: tuple[ho.Suggestion, ...] = ()
    note = ENDED
    with (
        ProgressBar("searching for changes that make it feasible", left) as progress,
        contextlib.suppress(TimeLimitError),
        time_limit(left),
    ):
        suggestions = find_suggestions(problem, error, progress=progress)
        note = ENDED if time_left() <= 0.0 else ""
    say("\n".join([*map(str, suggestions or (NO_CHANGE,)), *([note] if note else [])]), err=True)
    return suggestions, note


@command(
    "directory DIR",
    option("--closest", "Report the closest pairs of drones over time."),
    option("--picture", "Draw the same to a .png, .svg or .pdf file.", PATH, "FILE"),
    option(
        "--gamma",
        "For tracking_radius: how many times farther than drones vertices may be.",
        1.0,
        "FLOAT",
    ),
    option(
        "--survivable",
        "Report for how many losses of a drone there is a certified reaction (slow).",
    ),
)
def check(
    directory: Path, picture: Path | None, gamma: float, *, closest: bool, survivable: bool
) -> None:
    """Recompute the certificate of the plan in DIR, or of a plan.npz, from its polynomials only."""
    from hitchopt.exports.directory import certificate_content, changed_tables
    from hitchopt.plan import read_requested_plan

    path = plan_path(directory)
    saved = read_requested_plan(path)
    motion = saved.motion
    with ProgressBar("certifying") as progress:
        certificate = ho.certify(motion, progress, gamma)
    without: Sequence[Lost] = ()
    if survivable:
        from hitchopt.live.lost import survivable as survived

        with ProgressBar("planning reactions") as progress:
            share, without = survived(motion, progress=progress)
        certificate = replace(certificate, checks=(*certificate.checks, share))
        record(without_reaction=[asdict(lost) for lost in without])
    show_plan(saved.title, motion, certificate)
    record(certificate=certificate_content(motion, certificate, path))
    for lost in without:
        say(f"{lost.drone}, {lost.start:.4g} s to {lost.end:.4g} s: {lost.reason}")
    if closest or picture is not None:
        with ProgressBar("finding the closest neighbours"):
            neighbours = ho.closest(ho.Plan(motion, certificate), picture=picture)
        say(f"Closest neighbours\n{neighbours}\n", closest=str(neighbours).splitlines())
        if picture is not None:
            say(f"the closest neighbours over time are drawn in {picture}")
    certificate.raise_if_violated()
    words = "is another table than was written with the certificate; solve again"
    changed = [f"{path.with_name(name)}: {words}" for name in changed_tables(path.parent)]
    if changed := [*_changed_others(motion, path), *changed]:
        raise InfeasibleError((), "\n".join(changed))
    say(f"certified; recomputed from {path}")


def _changed_others(motion: Motion, path: Path) -> Iterator[str]:
    """Say which plans that fly beside that in a file are missing, or others by now.

    Their paths are tried from the working directory, from the plan's, and from that around it.
    """
    from hitchopt.motion.plan_file import is_of

    for each in motion.others:
        places = (plan_path(at / each.plan) for at in (Path(), path.parent, path.parent.parent))
        files = [place for place in places if place.is_file()]
        if not any(is_of(each, file) for file in files):
            state = f"{files[0]} is another plan" if files else "its plan is missing"
            yield f"others: {each.name} ({each.plan}): {state}; solve again beside what flies now"


@command("directory DIR")
def verify(directory: Path) -> None:
    """Prove the limits of the plan in DIR with an independent verifier.

    Ends with 0 where all are proven, with 3 where one is violated or not proven.
    """
    _show_verified(plan_path(directory))


def _show_verified(path: Path) -> None:
    """Prove the limits of a plan.npz, report every one, and exit with 3 unless all are proven."""
    from hitchopt.verify import GOOD, UnreadableError, cells, verdict, verify

    rows = []
    try:
        with ProgressBar("proving") as progress:
            for row in verify(path):
                rows.append(row)
                progress(f"proven or not: {row.name}")
    except UnreadableError as error:
        raise FileError(f"{path}: not a plan, or a damaged one: {error}") from error
    heads = ["check", "worst", "limit", "unit", "where", "when"]
    heads += ["verdict"] * any(row.verdict != "proven" for row in rows)
    shown = [dict(zip(heads, cells(row), strict=False)) for row in rows]
    say(f"{table('Limits', shown)}\n\n{verdict(rows)}", verified=[row._asdict() for row in rows])
    if any(row.verdict not in GOOD for row in rows):
        exit_infeasible()


def example_files() -> list[Path]:
    """Return the examples: in the package where it is installed, else in the checkout.

    One that flies beside another plan is none: alone it cannot be planned.
    """
    packed = PACKAGE / "examples"
    place = packed if packed.is_dir() else PACKAGE.parent / "problems"
    files = sorted([*place.glob("*.yaml"), *(place / "swarms").glob("*.yaml")])
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
        "Write a problem that carries an object, one of single drones, or a study of many plans.",
        None,
        choices=KINDS,
    ),
    option(
        "--drone model",
        "Write a problem for a model of drones, such as crazyflie_2.1: lengths, distances and "
        "tension fit.",
        str,
        "MODEL",
    ),
    option(
        "--schema",
        "Write problem.schema.json, with which editors complete and check problem files.",
    ),
    type=str,
    required=False,
)
def init(
    name: str | None,
    example: str | None,
    model: str | None,
    kind: str | None,
    *,
    listing: bool,
    schema: bool,
) -> None:
    """Write a commented problem file to start from, or an example.

    NAME is problem.yaml by default, study.yaml of a study, or the example's name.
    """
    if schema:
        from hitchopt.mission.loading import problem_schema

        text = json.dumps(problem_schema(), indent=2, ensure_ascii=False)
        Path(SCHEMA).write_text(f"{text}\n", encoding="utf-8")
        say(f"wrote {SCHEMA}; editors read it beside the problem files that name it", file=SCHEMA)
        return
    from hitchopt.values import closest_word

    files = {path.stem: path for path in example_files()}
    if listing:
        rows = [{"name": stem, "title": _title(path)} for stem, path in files.items()]
        say(table("Examples", rows), examples=rows)
        return
    if example is not None and example not in files:
        remedy = closest_word(example, [*files], "hitchopt init --list names them")
        raise InputError("example", example, "an example's name", remedy)
    chosen = {"example": example, "drone": model, "kind": kind}
    first, *others = [key for key, value in chosen.items() if value] or [""]
    if others:
        bound = f"left out with --{first}"
        raise InputError(f"--{others[0]}", chosen[others[0]], bound, "give one of the two")
    template = f"template_{kind}.yaml" if kind else "template.yaml"
    source = files[example] if example else PACKAGE / "mission" / template
    text, study = problem_text(source), kind == STUDY
    if model:
        from hitchopt.mission.template import for_drone

        text = for_drone(text, model)
    usual = example or (STUDY if study else "problem")
    path = _write_new(usual if name is None else name, text)
    if model:
        _show_models(ho.load_problem(path).team)
    say(f"wrote {path}; try: hitchopt {'sweep' if study else 'solve'} {path}", file=str(path))
    flight = source.with_suffix(".csv")
    if flight.is_file():
        flown = _write_new(str(path.with_suffix(".csv")), flight.read_text("utf-8"), (".csv",))
        say(f"wrote {flown}: a flight of it, simulated and recorded", recording=str(flown))


def _title(path: Path) -> str:
    title = re.search(r"^title: (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return title.group(1).strip("'\"") if title else ""


def problem_text(path: Path) -> str:
    """Return the text of a problem file, its schema named and sections of the template written."""
    from hitchopt.mission.template import expand_sections

    text = path.read_text(encoding="utf-8")
    if path.stem != f"template_{STUDY}":
        return MODELINE + expand_sections(text)
    from hitchopt.sweeps.study import SimulateKeys

    return expand_sections(text, simulate=(SimulateKeys, "#  ", ()))


def _write_new(name: str, text: str | None, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Write a file to ``name``, with one of the suffixes; refuse one that exists, text or not."""
    path = Path(name)
    if not path.name.strip("."):
        raise FileError(f"{name!r}: is no name for a file; give one, such as problem.yaml")
    if path.suffix not in suffixes:
        path = path.with_name(path.name + suffixes[0])
    if os.path.lexists(path):
        raise FileError(f"{path}: exists already; give another name, or remove it")
    if text is not None:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    return path
