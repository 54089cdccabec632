"""The gallery: a card for each problem file, and a page with its picture, YAML and Python."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

import hitchopt as ho
from generators.page_pictures import KINDS, screenshot
from generators.problem_collection import (
    GALLERY,
    PROBLEMS,
    REFUSED,
    ROOT,
    SECTIONS,
    Section,
    caption,
    entry,
)
from hitchopt.errors import FileError
from hitchopt.planners.ends import RolledLegs

INTRODUCTION = """# Gallery of problems

All problem files of the repository, each with its YAML and the equivalent Python to download. Pictures show moments of the plan, with the
drones' paths since the previous one; single drones are seen from above, with circles for their downwash ellipsoids.
"""

UNSOLVED = """These files are well-formed, but no plan meets their limits: `hitchopt solve` exits with
{doc}`exit code 3 </how_to/exit_code_3>` and names what binds. Pictures show the request: the start and
intermediate outlines grey and dashed, the last one in blue.
"""

REFUSALS = """## Invalid files

`hitchopt solve` returns {ref}`exit code 2 <exit-codes>` and the message shown.

| file | message |
|---|---|"""

WIDTH = 74
"""Maximum number of characters in a line of code."""


def write_gallery() -> dict[Path, str]:
    """Return the pages by path: the index, and a page and a program for each problem."""
    cards = [part for section in SECTIONS for part in _section(section)]
    rows = [_refused(x) for folder in REFUSED for x in sorted((PROBLEMS / folder).glob("*.yaml"))]
    toctree = "```{toctree}\n:hidden:\n:glob:\n\nexamples/**\n```\n"
    index = [INTRODUCTION, toctree, *cards, REFUSALS, *rows, ""]
    pages = {GALLERY / "index.md": "\n".join(index)}
    for section in SECTIONS:
        for file in section.files:
            page = GALLERY / section.page(file)
            pages |= {page: _example(section, file), page.with_suffix(".py"): program(file)}
    return pages


def program(file: Path) -> str:
    """Return a Python program that solves the problem of a file."""
    problem = python(ho.load_problem(file)).replace(f"{PROBLEMS}/", "")
    imports = ["import math\n"] * ("math." in problem) + ["import hitchopt as ho"]
    imports += ["from hitchopt import steps"] * ("steps." in problem)
    imports[-1] += "\n"
    last = f'plan = ho.solve(problem)\nprint(plan)\nplan.save("{file.stem}")\n'
    return "\n".join([*imports, f"problem = {problem}", last])


def python(value: Any, margin: int = 0, first: int = len("problem = ")) -> str:
    """Return the Python code of a value, with a margin, and ``first`` more on the first line."""
    value = getattr(value, "vertices", value)  # outlines as vertices
    if isinstance(value, RolledLegs):
        roll = value.roll if value.roll is None else np.degrees(value.roll).round(9)
        value = {"sharing": value.sharing, "roll_deg": roll}
    value = value.tolist() if hasattr(value, "tolist") else value
    parts: list[tuple[str, Any]]
    match value:
        case float():
            degrees = round(math.degrees(value), 6)
            angle = math.radians(degrees) == value and float(f"{value:g}") != value
            return f"math.radians({degrees:g})" if angle else repr(value + 0.0).removesuffix(".0")
        case str():
            return json.dumps(value, ensure_ascii=False)
        case int() | None:
            return repr(value)
        case dict():
            begin, end = "{", "}"
            parts = [(f"{python(key)}: ", each) for key, each in value.items()]
        case list() | tuple():
            begin, parts, end = "[", [("", each) for each in value], "]"
        case _:
            name = type(value).__name__
            begin, end = f"{'ho' if name in ho.__all__ else 'steps'}.{name}(", ")"
            parts = [(f"{name}=", each) for name, each in _arguments(value)]
    line = begin + ", ".join(f"{name}{python(each, 0, 0)}" for name, each in parts) + end
    if margin + first + len(line) < WIDTH and "\n" not in line:
        return line
    inside = [f"{name}{python(each, margin + 4, len(name))},\n" for name, each in parts]
    return f"{begin}\n{''.join(inside)}".replace("\n", "\n    ").removesuffix("    ") + end


def _arguments(record: Any) -> Iterator[tuple[str, Any]]:
    """Yield arguments that differ from their defaults; equal values of robots as one."""
    for name, parameter in signature(type(record)).parameters.items():
        if name.endswith("_deg"):  # an alias of an angle
            continue
        value = getattr(record, name)
        if isinstance(record, ho.Team) and len(set(map(python, _listed(value)))) == 1:
            value = value[0]
        code, is_required = python(value), parameter.default is parameter.empty
        if is_required or (code != python(parameter.default) and not code.endswith(("()", "{}"))):
            yield name, value


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, Sequence | np.ndarray) else []


def _example(section: Section, file: Path) -> str:
    """Return the page of a problem."""
    page, path = section.page(file), file.relative_to(PROBLEMS).as_posix()
    up, title, lasts = "../" * (len(page.parents) + 1), _title(file), entry(file, "# Lasts", "")
    pictures = {
        "Moments of the plan" if section.solved else "The request": section.picture(file),
        "Film": PROBLEMS / f"pictures/{file.stem}.webp",
    }
    pictures |= {words: screenshot(file.stem, kind) for kind, words in KINDS.items()}
    figures = "\n\n".join(
        f"```{{figure}} {up}{picture.relative_to(ROOT).as_posix()}\n:alt: {title}\n\n{words}\n```"
        for words, picture in pictures.items()
        if picture.exists()
    )
    return f"""# {title}

{_text(section, file)}{f" The plan lasts {lasts} s." if lasts else ""}

{figures}

## Problem file

{{download}}`{path} <{up}problems/{path}>`; plan it with `hitchopt solve {file.name}`:

```{{literalinclude}} {up}problems/{path}
:language: yaml
```

## The same in Python

{{download}}`{file.stem}.py`:

```{{literalinclude}} {file.stem}.py
```
"""


def _section(section: Section) -> list[str]:
    """Return the cards of a section, each with a picture, a title and a link to its page."""
    lines = [f"## {section.heading}\n", *([] if section.solved else [UNSOLVED])]
    cards = [
        f":::{{grid-item-card}} {_title(file)}\n"
        f":img-top: {section.picture(file).relative_to(GALLERY).as_posix()}\n"
        f":img-alt: {_title(file)}\n:link-type: doc\n"
        f":link: {section.page(file).with_suffix('').as_posix()}\n:::"
        for file in section.files
    ]
    return [*lines, "::::{grid} 2 3 4 5\n:gutter: 2\n", *cards, "::::\n"]


def _title(file: Path) -> str:
    return entry(file, "title", file.stem.replace("_", " "))


def _text(section: Section, file: Path) -> str:
    """Return the comment of a problem, and the violated limit if it has no plan."""
    text = " ".join(line or "\n\n" for line in caption(file))
    binds = "" if section.solved else f" Binds: {entry(file, '# Binds', 'see the message')}."
    return re.sub(r"([\\*_\[\]<>$])", r"\\\1", text) + binds


def _refused(file: Path) -> str:
    name = file.relative_to(PROBLEMS).as_posix()
    try:
        ho.load_problem(file)
    except (ho.InputError, FileError) as error:
        message = " ".join(str(error).replace(str(file), file.name).split())
        message = message.replace(f"{PROBLEMS}/", "")
    else:
        raise AssertionError(f"{name} is read without an error")
    # Cells are limited in length and characters.
    short = message if len(message) <= 240 else f"{message[:239]}…"
    printable = "".join(c if c.isprintable() else "�" for c in short)
    return f"| `{name}` | `` {printable.replace('|', chr(92) + '|').replace('``', '')} `` |"
