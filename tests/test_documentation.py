"""What README and documentation show is what happens, and nothing public lacks a place in them.

Code blocks of a page are executed one after the other in one directory. Blocks of Python share
their names; what one prints is shown in the block after it. Blocks of YAML that begin with a
comment ``# name.yaml`` are written to files. In ``console`` blocks lines after ``$`` are commands,
and what they print follows, unless nothing is shown.
"""

from __future__ import annotations

import ast
import io
import re
import runpy
import shlex
import signal
from collections.abc import Iterable, Iterator
from contextlib import redirect_stdout
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import click
import jsonschema
import pytest
from click.testing import CliRunner
from generators.check_facts import write_check_facts, write_check_page, write_check_table
from generators.gallery_page import python, write_gallery
from generators.page_pictures import KINDS, SCREENSHOTS, screenshot
from generators.problem_collection import GALLERY, PICTURES, SECTIONS, Section, caption
from generators.schema_page import write_schema_page
from generators.script_page import SCRIPTS, write_script_page
from generators.steps_page import write_steps_page
from matplotlib import rc_context
from ruamel.yaml import YAML

import hitchopt as ho
from hitchopt.checks.registry import REPORTS, RULES
from hitchopt.cli import main
from hitchopt.cli.failures import EXIT_INFEASIBLE, EXIT_USAGE
from hitchopt.cli.planning import PACKAGE, problem_text
from hitchopt.mission.loading import problem_schema
from hitchopt.slices import by_module
from hitchopt.storage.interrupts import EXIT_INTERRUPTED
from tests.helpers.plans import PROBLEMS, ROOT

ROOMS = ho.ROOM_NAMES | by_module("room_names")  # Names by their modules

FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
ALL_HOLD = re.compile(r"\b(\d+) of \1 limits hold")
NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TINY = 1e-6  # Numbers below this are rounding, and differ between processors


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str  # or directive
    text: str


class Shown(NamedTuple):
    """What a block or command prints, what the page shows of it, and a command's exit code."""

    code: str
    printed: str
    shown: str
    status: int = 0


def blocks(text: str) -> list[Block]:
    """Return all fenced blocks of a page, without the indentation of lists."""
    found = []
    for indent, language, body in FENCE.findall(text):
        lines = [line.removeprefix(indent) for line in body.splitlines(keepends=True)]
        found.append(Block(language.strip(), "".join(lines)))
    return found


def executed(text: str) -> Iterator[Shown]:
    """Yield what the blocks of a page print, in the working directory."""
    page, status = blocks(text), 0
    names: dict[str, object] = {"__name__": "__main__"}
    for block, following in zip(page, [*page[1:], Block("", "")], strict=True):
        if block.language == "python":
            stream = io.StringIO()
            with redirect_stdout(stream):
                exec(compile(block.text, "<page>", "exec"), names)
            shown = following.text if following.language in {"", "text"} else ""
            yield Shown(block.text, stream.getvalue(), shown)
        elif block.language == "yaml" and (name := file_name(block)):
            Path(name).write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
                command, _, shown = part.partition("\n")
                if command == "echo $?":
                    yield Shown(command, f"{status}\n", shown)
                    continue
                status, printed = run(command)
                yield Shown(command, printed, shown, status)


def file_name(block: Block) -> str:
    """Return the name in the first comment of a block of YAML, or nothing."""
    found = re.match(r"# ([\w-]+\.yaml)\n", block.text)
    return found[1] if found else ""


def run(command: str) -> tuple[int, str]:
    """Return the exit code of a command of hitchopt, and all that it prints."""
    program, *arguments = shlex.split(command, comments=True)
    assert program == "hitchopt", f"{command}: only hitchopt is run"
    done = CliRunner().invoke(main, arguments, catch_exceptions=False, prog_name="hitchopt")
    return done.exit_code, click.unstyle(done.output)


def same(printed: str, shown: str) -> bool:
    """Return whether two texts agree: words exactly, numbers to the last digit but one shown.

    An ellipsis at the end of a line stands for the rest of it. Counts of kept limits agree.
    """
    ours, theirs = (ALL_HOLD.sub("all limits hold", x).split("\n") for x in (printed, shown))
    return len(ours) == len(theirs) and all(map(_same_line, ours, theirs))


def _same_line(printed: str, shown: str) -> bool:
    if shown.endswith("…"):
        return printed.startswith(shown.removesuffix("…").rstrip())
    if NUMBER.sub("#", printed).split() != NUMBER.sub("#", shown).split():
        return False
    return all(map(_same_number, NUMBER.findall(printed), NUMBER.findall(shown)))


def _same_number(printed: str, shown: str) -> bool:
    a, b = printed.replace("−", "-"), shown.replace("−", "-")
    x, y = float(a), float(b)
    if "." not in a + b and "e" not in a + b:
        return x == y
    places = max(len(each.partition("e")[0].partition(".")[2]) for each in (a, b))
    unit = 10.0 ** (float(b.partition("e")[2] or 0) - places)
    return abs(x - y) <= 1.5 * unit or max(abs(x), abs(y)) < TINY


DOCS = ROOT / "docs"
CHECKS = [rule.name for rule in (*RULES, *REPORTS)]

# Folders of pages that are not written by hand
GENERATED = {"generated", "_build", "gallery"}
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(page for page in sorted(DOCS.rglob("*.md")) if not GENERATED & set(page.parts)),
]
# Blocks that are executed, and not; those of YAML are checked against the schema
RUN, SHOWN = {"python", "console"}, {"", "text", "sh", "yaml", "json"}
LONG = {  # Blocks that take longest
    *("carry.md", "export.md", "fit.md", "look_at_a_plan.md"),
    *("describe_your_drones.md", "measure_your_flight.md", "several_teams.md"),
}


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


CASES = [
    pytest.param(page, marks=pytest.mark.slow if page.name in LONG else (), id=name_of(page))
    for page in PAGES
    if any(block.language in RUN for block in blocks(text_of(page)))
]


@pytest.mark.parametrize("page", CASES)
def test_blocks_print_what_is_shown(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    found = list(executed(text_of(page)))
    for done, following in zip_longest(found, found[1:]):
        if done.shown or not done.code.startswith("hitchopt "):
            assert same(done.printed, done.shown), f"{done.code}\nprints\n{done.printed}"
        failing = following is not None and following.code == "echo $?"
        assert failing == (done.status != 0), f"{done.code}\n{done.printed}"


# Commands of README that set up an environment
SET_UP = ("make ", "python3 -m venv ", "pip ")


@pytest.mark.slow
def test_readme_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks but the set-up run in order in an empty folder, without a warning."""
    monkeypatch.chdir(tmp_path)
    commands = 0
    for block in blocks(text_of(ROOT / "README.md")):
        if block.language == "python":
            with redirect_stdout(io.StringIO()):
                exec(compile(block.text, "<README>", "exec"), {"__name__": "__main__"})
        for command in block.text.splitlines() if block.language == "sh" else ():
            if not command.startswith(SET_UP):
                status, printed = run(command)
                assert status == 0, f"{command}\n{printed}"
                assert "warning" not in printed, printed
                commands += 1
    assert commands == 4


def test_every_block_is_executed_or_text_and_links_lead_to_files() -> None:
    for page in PAGES:
        text = text_of(page)
        notebook = text.startswith("---\nfile_format: mystnb")
        for block in blocks(text):
            directive = block.language.startswith("{")
            code = block.language.startswith("{code-cell}")
            assert code <= notebook, f"{page}: a code cell outside of an executed page"
            assert directive or block.language in RUN | SHOWN, f"{page}: {block.language}"
        links = re.findall(r"\]\(([^)#]+)[^)]*\)", text)
        local = [link for link in links if "://" not in link]
        missing = [link for link in local if not (page.parent / link).exists()]
        assert not missing, f"{page}: {missing}"


def test_the_documentation_stays_short() -> None:
    """The reference of API and commands is not counted; that of keys is generated."""
    reference = {DOCS / "reference" / name for name in ("api.md", "command_line.md")}
    pages = [page for page in PAGES if DOCS in page.parents]
    words = sum(len(text_of(page).split()) for page in pages if page not in reference)
    assert len(pages) <= 40
    assert words <= 22_000


def test_yaml_has_keys_of_the_schema() -> None:
    yaml, validator = YAML(typ="safe", pure=True), jsonschema.Draft202012Validator(problem_schema())
    template = yaml.load(problem_text(PACKAGE / "mission" / "template.yaml"))
    for block in (b for page in PAGES for b in blocks(text_of(page)) if b.language == "yaml"):
        given = yaml.load(block.text)
        problem = given if file_name(block) or "goal" in given else {**template, **given}
        assert not [*validator.iter_errors(problem)], block.text


def test_every_check_has_a_row_that_says_what_it_proves_and_what_not() -> None:
    assert "reference/generated/checks.inc" in text_of(DOCS / "explanation" / "certificate.md")
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \|$", write_check_table(), re.MULTILINE)
    assert [name for name, *_ in rows] == [*CHECKS]
    assert all(len(bound) > 10 and len(unproven) > 10 for _, bound, unproven in rows)
    facts, page = write_check_facts(), write_check_page()
    assert set(facts) == set(CHECKS)
    assert all(f"(check-{name})=\n## `{name}`\n" in page for name in CHECKS)
    assert "must not fall below" in facts["separation"]
    assert "must not rise above" in facts["speed"]
    assert "yes, against 10 times the limit" in facts["cable_length"]


def test_every_step_and_key_is_in_the_tables() -> None:
    definitions = problem_schema()["$defs"]
    cells = re.findall(r"^\| (`[^|]*)\|", text_of(ROOT / "README.md"), re.MULTILINE)
    names = set(re.findall(r"`(\w+)`", " ".join(cells)))
    assert set(definitions["Step"]["properties"]) <= names
    page = write_schema_page()
    for definition in definitions.values():
        for key, value in definition.get("properties", {}).items():
            assert f"| `{key}` |" in page
            assert value.get("description", "") in page.replace(r"\|", "|")
    for target in re.findall(r"<(keys-\w+)>", page):
        assert f"({target})=" in page


def test_commands_and_options_that_pages_show_exist() -> None:
    context = click.Context(main)
    commands: dict[str, Any] = {
        x: main.get_command(context, x) for x in main.list_commands(context)
    }
    cells = [b for page in PAGES for b in blocks(text_of(page))]
    shown = [b.text for b in cells if b.language in {"sh", "text", "{code-cell} python"}]
    calls = re.findall(r"(?:^|&& )hitchopt (\w+)([^#|&\n]*)", "\n".join(shown), re.MULTILINE)
    assert len(calls) > 10
    for name, options in calls:
        known = {
            opt for each in commands[name].params for opt in (*each.opts, *each.secondary_opts)
        }
        assert set(re.findall(r"(?<= )--?[a-z][\w-]*", options)) <= known, (name, options)


def test_exit_codes_and_public_names_have_their_places() -> None:
    codes = re.findall(
        r"^\| (\d+) \|", text_of(DOCS / "reference" / "command_line.md"), re.MULTILINE
    )
    assert [int(code) for code in codes] == [
        0,
        EXIT_USAGE,
        EXIT_INFEASIBLE,
        EXIT_INTERRUPTED,
        128 + signal.SIGTERM,
    ]
    pages = text_of(DOCS / "reference" / "api.md") + write_steps_page()
    listed = re.findall(r"^   ([\w.]+)$", pages, re.MULTILINE)
    in_rooms = [f"{room}.{name}" for room, names in ROOMS.items() for name in names]
    assert sorted(listed) == sorted([*ho.__all__, *in_rooms])


gallery = cache(write_gallery)


def test_the_gallery_has_a_page_with_a_picture_and_downloads_for_every_problem() -> None:
    pages = gallery()
    index = pages[GALLERY / "index.md"]
    pictures = {file: each.picture(file) for each in SECTIONS for file in each.files}
    assert len(pictures) > 50
    for section in SECTIONS:
        for file in section.files:
            assert pictures[file].exists(), f"make gallery draws {file.stem}"
            assert f":link: {section.page(file).with_suffix('').as_posix()}\n" in index
            page = pages[GALLERY / section.page(file)]
            for path in (pictures[file], file):
                assert f"/{name_of(path)}" in page
            assert f"{{download}}`{file.stem}.py`" in page
            assert caption(file), f"{file} has no comment at its head"
    assert set(PICTURES.rglob("*.png")) == set(pictures.values())
    refused = [file for bad in ("bad", "swarms/bad") for file in (PROBLEMS / bad).glob("*.yaml")]
    assert index.count("\n| `bad/") + index.count("\n| `swarms/bad/") == len(refused)
    for stem in SCREENSHOTS:
        for path in (screenshot(stem, kind) for kind in KINDS):
            assert path.stat().st_size > 10_000, "make screenshots takes it"
            assert f"/{name_of(path)}" in pages[GALLERY / "examples" / f"{stem}.md"]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.heading)
def test_the_gallery_s_programs_state_the_problems_of_its_files(
    section: Section, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(PROBLEMS)  # one of them names the plan of a show
    for file in section.files:
        page = (GALLERY / section.page(file)).with_suffix(".py")
        statement, _, rest = gallery()[page].partition("\nplan = ho.solve(problem)\n")
        names: dict[str, Any] = {}
        exec(statement, names)
        stated = python(names["problem"]), statement.partition("problem = ")[2]
        here, there = (re.sub(r",?\s*(?=[])}])|\s", "", each) for each in stated)
        assert here == there  # but for breaks of lines, since names of files are longer elsewhere
        assert file.stem in rest


# Scripts that take longer than some two seconds, which only the documentation executes
LONG_SCRIPTS = {
    "carry_a_tray",
    "experiment_2",
    "over_a_wall",
    "repair",
    "simulate",
    "tie_and_untie",
}


def test_scripts_are_short_and_assert_what_they_print() -> None:
    assert len(SCRIPTS) == 19
    assert {file.stem for file in SCRIPTS} >= LONG_SCRIPTS
    page = write_script_page()
    for file in SCRIPTS:
        text = text_of(file)
        assert len(text.splitlines()) <= 45, file
        assert f"%script {file.stem}\n" in page
        tree = ast.parse(text)
        assert (ast.get_docstring(tree) or "").count(".") == 1, file  # one idea, one sentence
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        printed = [x for x in calls if isinstance(x.func, ast.Name) and x.func.id == "print"]
        asserted = _names(node for node in ast.walk(tree) if isinstance(node, ast.Assert))
        assert printed, file
        for call in printed:
            assert _names([call]) & asserted - {"ho", "np"}, f"{file}: {ast.unparse(call)}"


def _names(nodes: Iterable[ast.AST]) -> set[str]:
    found = (each for node in nodes for each in ast.walk(node))
    return {each.id for each in found if isinstance(each, ast.Name)}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x.stem, marks=pytest.mark.slow if x.stem == "custom_cost" else ())
        for x in SCRIPTS
        if x.stem not in LONG_SCRIPTS
    ],
)
def test_scripts_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (file,) = (each for each in SCRIPTS if each.stem == name)
    stream = io.StringIO()
    with redirect_stdout(stream), rc_context():  # scripts may choose fonts
        runpy.run_path(str(file), run_name="__main__")
    assert stream.getvalue()


def test_texts_are_compared_by_their_digits() -> None:
    for a, b in (
        ("a 1.001 b", "a 1.002 b"),
        ("3.4e-09", "9.1e-10"),
        ("a long line", "a long …"),
        ("15 of 15 limits hold", "16 of 16 limits hold"),
    ):
        assert same(a, b)
    for a, b in (
        ("a 1.001 b", "a 1.005 b"),
        ("3 rows", "4 rows"),
        ("one", "two"),
        ("1\n2", "1"),
        ("15 of 16 limits hold", "16 of 16 limits hold"),
    ):
        assert not same(a, b)
