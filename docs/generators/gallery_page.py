"""The gallery: every problem file of the repository with its picture and its comment."""

from __future__ import annotations

import re
from pathlib import Path

import hitchopt as ho
from generators.page_pictures import KINDS, SCREENSHOTS
from generators.problem_collection import (
    PICTURES,
    PROBLEMS,
    REFUSED,
    SECTIONS,
    Section,
    caption,
    entry,
)

INTRODUCTION = """# Gallery of problems

All problem files of the repository. `hitchopt solve problems/triangle.yaml` plans one. Pictures show the plan
from above: the start dashed and grey, the end in colours, the drones' paths between; circles are the drones'
downwash ellipsoids.
"""

PAGES = """## In the browser

The live view of `hitchopt view` and the file of `hitchopt report` ({doc}`/how_to/look_at_a_plan`) show three of these
problems.
"""

UNSOLVED = """These files are well-formed, and no plan meets their limits: `hitchopt solve` ends with
{doc}`exit code 3 </reference/exit_codes>` and names what binds. Pictures show what they ask for: the start, the
outlines on the way grey and dashed, the last one in blue.
"""

REFUSALS = """## Files that are wrong in themselves

`hitchopt solve` ends with {doc}`exit code 2 </reference/exit_codes>` on these, with the message beside them.
There is nothing to draw.

| file | message |
|---|---|"""


def write_gallery_page() -> str:
    """Return the page, one figure for every problem and one row for every refused file."""
    sections = [part for section in SECTIONS for part in _section(section)]
    rows = [_refused(x) for folder in REFUSED for x in sorted((PROBLEMS / folder).glob("*.yaml"))]
    return "\n".join([INTRODUCTION, *sections, PAGES, *_screenshots(), REFUSALS, *rows, ""])


def _screenshots() -> list[str]:
    lines = []
    for shown in SCREENSHOTS:
        for kind, name in KINDS.items():
            path = shown.picture(kind).relative_to(PICTURES.parent).as_posix()
            words = f"{name[0].upper()}{name[1:]}: {shown.words}"
            lines += [f"```{{figure}} {path}\n:alt: {words}\n\n{words}.\n```", ""]
    return lines


def _section(section: Section) -> list[str]:
    lines = [f"## {section.heading}", "", *([] if section.solved else [UNSOLVED, ""])]
    return [
        *lines,
        "::::{grid} 1 2 3 3",
        *(_card(section, file) for file in section.files),
        "::::\n",
    ]


def _card(section: Section, file: Path) -> str:
    name, title = file.relative_to(PROBLEMS), entry(file, "title", file.stem.replace("_", " "))
    picture = section.picture(file).relative_to(PICTURES.parent).as_posix()
    text = " ".join(line or "\n\n" for line in caption(file))
    escaped = re.sub(r"([\\*_\[\]<>$])", r"\\\1", text)
    binds = "" if section.solved else f"\n\nBinds: {entry(file, '# Binds', 'see the message')}."
    head = f":::{{grid-item-card}} {title}\n:img-top: {picture}\n:img-alt: {title}, from above\n\n"
    path = name.as_posix()
    return (
        f"{head}{escaped}{binds}\n\n`problems/{path}` {{download}}`YAML </../problems/{path}>`\n:::"
    )


def _refused(file: Path) -> str:
    name = file.relative_to(PROBLEMS).as_posix()
    try:
        ho.read_problem(file)
    except (ho.InputError, ho.FileError) as error:
        message = " ".join(str(error).split()).replace(str(file), file.name)
    else:
        raise AssertionError(f"{name} is read without an error")
    # The beginning of the message as code, as a cell can hold it.
    short = message if len(message) <= 240 else f"{message[:239]}…"
    printable = "".join(c if c.isprintable() else "�" for c in short)
    return f"| `{name}` | `` {printable.replace('|', chr(92) + '|').replace('``', '')} `` |"
