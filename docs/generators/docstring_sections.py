"""Sections of docstrings, such as ``Parameters``, as reStructuredText.

Entries are ``name, name: what they are``, without a type: types are in the signature.
"""

from __future__ import annotations

import re
from typing import Any

SECTIONS = ("Parameters", "Attributes", "Raises", "Returns", "Yields", "Notes", "References")

ENTRY = re.compile(r"^([\w.*`]+(?:, [\w.*`]+)*)\s*: (.*)$")


STAR = re.compile(r"(?<=[(\s])\*(?=\w+[,)])")
"""Star of a shape such as ``(times, *shape)``, which is no markup."""


def process_docstring(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Rewrite a docstring's sections; Sphinx calls it for every object."""
    del app, what, name, obj, options
    lines[:] = converted(lines)


def converted(lines: list[str]) -> list[str]:
    """Return the lines with sections as rubrics and definition lists."""
    lines = [STAR.sub(r"\\*", line) for line in lines]
    out: list[str] = []
    within = False
    i = 0
    while i < len(lines):
        line = lines[i]
        ruled = i + 1 < len(lines) and set(lines[i + 1].strip()) == {"-"}
        if ruled and line.strip() in SECTIONS:
            out += [f".. rubric:: {line.strip()}", ""]
            within = line.strip() in SECTIONS[:3]
            i += 2
            continue
        if within:
            found = ENTRY.match(line)
            if found:
                names = ", ".join(f"``{each.strip('`')}``" for each in found[1].split(", "))
                out += ["", names, f"    {found[2]}"]
            else:
                out.append(line)
        else:
            out.append(line)
        i += 1
    return out
