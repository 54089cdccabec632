"""Problem files of ``hitchopt init``, with sections that list the keys of records."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence

import numpy as np

from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.hitch.team import MODELS
from hitchopt.mission.objects import SECTION_KEYS, ObjectKeys
from hitchopt.mission.problem import HITCH_LIMITS, HITCH_SEPARATION, SwarmTeam
from hitchopt.storage.yaml_file import flow, parse_yaml, split_key, value_at, with_value
from hitchopt.values.fields import EMPTY, keys_of

SECTIONS: dict[str, tuple[type, str, Sequence[str]]] = {
    "team": (Team, "  #", ()),
    "carrying_team": (Team, "  #", ("tension",)),
    "limits": (Limits, "#  ", ()),
    "separation": (Separation, "#  ", ()),
    "object": (ObjectKeys, "    #", (*SECTION_KEYS, "rim")),
    "swarm_team": (SwarmTeam, "  #", ()),
    "swarm_limits": (Limits, "#  ", HITCH_LIMITS),
    "swarm_separation": (Separation, "#  ", HITCH_SEPARATION),
}
"""Records by section, with the prefixes of their lines and the fields to exclude."""

COLUMN, WIDTH = 26, 96
"""Column of comments, and maximum length of a line."""

LENGTHS = (
    *("team.cable_length", "arena.lower", "arena.upper", "start.drones.q", "start.drones.r"),
    *("mission[0].form.polygon", "mission[0].form.altitude", "mission[1].morph.polygon"),
)
"""Keys of the template's lengths."""

NOMINAL_RADIUS = 0.22
"""Radius of drones plus twice their tracking error for which the template is made [m]."""


def for_drone(text: str, name: str) -> str:
    """Return the template adapted to a model of drones: lengths, distances and tension."""
    kind, (radius, height) = Quadrotor(model=name), MODELS[name].separation
    factor, data = (radius + 2.0 * (kind.loop.tracking or 0.0)) / NOMINAL_RADIUS, parse_yaml(text)
    values = {key: np.multiply(factor, value_at(data, split_key(key))) for key in LENGTHS}
    changed = {key: np.round(value, 2).tolist() for key, value in values.items()}
    changed |= {"team.quadrotor": name, "team.tension": kind.tension}
    if (radius, height) != (Separation().radius, Separation().height):
        changed |= {"separation": {"radius": radius, "height": height}}
    for key, value in changed.items():
        text = with_value(text, split_key(key), value)
    return text


def expand_sections(text: str, **extra: tuple[type, str, Sequence[str]]) -> str:
    """Return a template with lines such as ``# (limits)`` replaced by all keys and defaults.

    ``extra`` are further sections.
    """
    sections = SECTIONS | extra
    return re.sub(r" *# \((\w+)\)\n", lambda match: _lines(*sections[match[1]]), text)


def _lines(record: type, prefix: str, exclude: Sequence[str] = ()) -> str:
    """Return comment lines for the keys of a record with a default."""
    lines = list[str]()
    for name, key in keys_of(record).items():
        if key.default is EMPTY or name in exclude:
            continue
        is_nested = key.name == "quadrotor"
        value = "" if is_nested else f" {flow(key.to_file(key.default))}"
        first, *rest = textwrap.wrap(key.described(key.file_kind), WIDTH - COLUMN - 2)
        lines += [f"{prefix} {key.name}:{value}".ljust(COLUMN) + f"# {first}"]
        lines += [f"{prefix.ljust(COLUMN)}# {line}" for line in rest]
        if is_nested:
            lines += [_lines(Quadrotor, f"{prefix}  ").rstrip("\n")]
    return "\n".join(lines) + "\n"
