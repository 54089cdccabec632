"""The files that ``hitchopt init`` writes: their sections list the keys of records."""

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
"""Records by the names of sections, what begins their lines, and fields that are left out."""

COLUMN, WIDTH = 26, 96
"""Column of comments, and most characters of a line."""

LENGTHS = (
    *("team.cable_length", "arena.lower", "arena.upper", "start.drones.q", "start.drones.r"),
    *("mission[0].form.polygon", "mission[0].form.altitude", "mission[1].morph.polygon"),
)
"""Keys of the template's lengths."""

ROOM = 0.22
"""[m] Radius of drones, and twice how far they may be off, that the template's lengths suit."""


def for_drone(text: str, name: str) -> str:
    """Return the template's text for a model of drones: lengths, distances and tension."""
    kind, (radius, height) = Quadrotor(model=name), MODELS[name].separation
    factor, data = (radius + 2.0 * (kind.loop.tracking or 0.0)) / ROOM, parse_yaml(text)
    values = {key: np.multiply(factor, value_at(data, split_key(key))) for key in LENGTHS}
    changed = {key: np.round(value, 2).tolist() for key, value in values.items()}
    changed |= {"team.quadrotor": name, "team.tension": kind.tension}
    if (radius, height) != (Separation().radius, Separation().height):
        changed |= {"separation": {"radius": radius, "height": height}}
    for key, value in changed.items():
        text = with_value(text, split_key(key), value)
    return text


def filled_in(text: str, **more: tuple[type, str, Sequence[str]]) -> str:
    """Return a template with lines such as ``# (limits)`` replaced by all keys and defaults.

    ``more`` are sections of records that only callers know.
    """
    sections = SECTIONS | more
    return re.sub(r" *# \((\w+)\)\n", lambda match: _lines(*sections[match[1]]), text)


def _lines(record: type, begin: str, without: Sequence[str] = ()) -> str:
    """Return a comment line, or several, for every key of a record that has a default."""
    lines = list[str]()
    for name, key in keys_of(record).items():
        if key.default is EMPTY or name in without:
            continue
        nested = key.name == "quadrotor"
        value = "" if nested else f" {flow(key.to_file(key.default))}"
        words = key.described(key.file_kind)
        head = f"{begin} {key.name}:{value}".ljust(COLUMN)
        first, *more = textwrap.wrap(words, WIDTH - COLUMN - 2)
        lines += [f"{head}# {first}", *(f"{begin}{' ' * (COLUMN - len(begin))}# {x}" for x in more)]
        if nested:
            lines += [_lines(Quadrotor, f"{begin}  ").rstrip("\n")]
    return "\n".join(lines) + "\n"
