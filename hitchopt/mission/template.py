"""The problem file that ``hitchopt init`` writes: its sections list the keys of records."""

from __future__ import annotations

import re
import textwrap

from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.storage.yaml_file import flow
from hitchopt.values.fields import EMPTY, keys_of

SECTIONS = {"team": (Team, "  #"), "limits": (Limits, "#  "), "separation": (Separation, "#  ")}
"""Records by the names of sections, and what begins their lines."""

COLUMN, WIDTH = 26, 96
"""Column of comments, and most characters of a line."""


def filled_in(text: str) -> str:
    """Return a template with lines such as ``# (limits)`` replaced by all keys and defaults."""
    return re.sub(r" *# \((\w+)\)\n", lambda match: _lines(*SECTIONS[match[1]]), text)


def _lines(record: type, begin: str) -> str:
    """Return a comment line, or several, for every key of a record that has a default."""
    lines = list[str]()
    for key in keys_of(record).values():
        if key.default is EMPTY:
            continue
        nested = record is Team and key.name == "quadrotor"
        value = "" if nested else f" {flow(key.to_file(key.default))}"
        words = key.described(key.file_kind)
        head = f"{begin} {key.name}:{value}".ljust(COLUMN)
        first, *more = textwrap.wrap(words, WIDTH - COLUMN - 2)
        lines += [f"{head}# {first}", *(f"{begin}{' ' * (COLUMN - len(begin))}# {x}" for x in more)]
        if nested:
            lines += [_lines(Quadrotor, f"{begin}  ").rstrip("\n")]
    return "\n".join(lines) + "\n"
