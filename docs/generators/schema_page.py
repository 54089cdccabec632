"""The reference of the problem file, from its JSON Schema."""

from __future__ import annotations

import json
import re
from typing import Any

from hitchopt.mission.loading import problem_schema
from hitchopt.values.fields import Schema

KEYS = ("title", "team", "teams", "limits", "separation", "arena", "objects", "keep_out", "start")
"""Keys of files that come first, in this order."""

INTRODUCTION = """# Problem file

A problem file is YAML with the keys of {ref}`one of three kinds <keys-problem>`: a team with cables and its
mission, {ref}`single drones <keys-swarmproblem>`, or {ref}`several teams <keys-teamsproblem>`. Every key that is not listed is an error. Lengths are in
metres, times in seconds, angles in degrees where a key ends in `_deg`. `hitchopt init` writes a file to start
from, and `hitchopt init --schema` a JSON Schema that editors use to complete and check keys.
"""

HEADINGS = {
    "Problem": "A team with cables",
    "SwarmProblem": "Single drones",
    "TeamsProblem": "Several teams",
    "ObjectKeys": "Objects",
    "Step": "Steps",
}
"""Headings that differ from the names of definitions; whole files come first."""


def write_schema_page() -> str:
    """Return the page: a section and a table of keys for each definition of the schema."""
    definitions: Any = problem_schema()["$defs"]
    sections: dict[str, str] = {}

    def add(name: str, level: str) -> None:
        """Add the section of a definition, then the sections of its keys' definitions."""
        if name not in sections:
            sections[name] = _section(name, level, definitions[name])
            for key in _keys(definitions[name]) or [definitions[name]]:
                for each in re.findall(r"#/\$defs/(\w+)", json.dumps(key)):
                    add(each, "##" if name.endswith("Problem") else "###")

    for name in ("Problem", "SwarmProblem", "TeamsProblem"):
        add(name, "##")
    return "\n".join([INTRODUCTION, *sections.values()])


def heading(name: str) -> str:
    """Return the heading of a definition: its name in words, without the suffix ``Keys``."""
    words = "".join(f" {c.lower()}" if c.isupper() else c for c in name.removesuffix("Keys"))
    return HEADINGS.get(name, words.strip().capitalize())


def _keys(definition: Schema) -> list[tuple[str, Schema]]:
    """Return a definition's keys with their schemas, starting with those in ``KEYS``."""
    keys = definition.get("properties", {}).items()
    return sorted(keys, key=lambda item: KEYS.index(item[0]) if item[0] in KEYS else len(KEYS))


def _section(name: str, level: str, definition: Schema) -> str:
    rows = [
        f"| `{key}` | {_cell(in_words(value))} | {_default(key, value, definition)} | "
        f"{_cell(value.get('description', ''))} |"
        for key, value in _keys(definition)
    ]
    words = [f"(keys-{name.lower()})=", f"{level} {heading(name)}", ""]
    if definition.get("description"):
        words += [definition["description"], ""]
    if rows:
        words += ["| key | value | default | meaning |", "|---|---|---|---|", *rows, ""]
    elif "oneOf" in definition or "anyOf" in definition:
        words += [f"One of: {_cell(in_words(definition))}.", ""]
    return "\n".join(words)


def in_words(value: Schema) -> str:  # noqa: PLR0911
    """Return the values of a schema in words, with links to definitions."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"{{ref}}`{heading(name)} <keys-{name.lower()}>`"
    if "const" in value:
        return f"`{_as_text(value['const'])}`"
    if "enum" in value:
        return " or ".join(f"`{_as_text(each)}`" for each in value["enum"])
    for kind in ("oneOf", "anyOf", "allOf"):
        if kind in value:
            words = [in_words(each) for each in value[kind] if each.get("type") != "null"]
            return " or ".join(dict.fromkeys(words))
    match value.get("type"):
        case "array":
            return _list_in_words(value)
        case "object":
            each = value.get("additionalProperties")
            return f"mapping of names to {in_words(each)}" if each else "mapping"
        case "number" | "integer":
            return f"{value['type']}{_range(value)}"
        case "string":
            return "text"
        case _:
            return str(value.get("type", "any"))


def _list_in_words(value: Schema) -> str:
    minimum, maximum = value.get("minItems"), value.get("maxItems")
    items = in_words(value["items"])
    if items.startswith(("number", "integer", "list")) or items[:1].isdigit():
        first, _, rest = items.partition(" ")
        items = f"lists of {items}" if items[:1].isdigit() else f"{first}s {rest}".strip()
    return (
        f"{minimum} {items}" if minimum is not None and minimum == maximum else f"list of {items}"
    )


def _range(value: Schema) -> str:
    """Return informative bounds in words; bounds of the order of 1e9 only catch mistakes."""
    minimum, above = value.get("minimum"), value.get("exclusiveMinimum")
    maximum, below = value.get("maximum"), value.get("exclusiveMaximum")
    words = []
    if above is not None or (minimum is not None and 0.0 < minimum <= 1e-6):
        words.append(f"above {above or 0:g}")
    elif minimum is not None and abs(minimum) < 1e8:
        words.append(f"from {minimum:g}")
    if below is not None and below < 1e4:
        words.append(f"below {below:g}")
    elif maximum is not None and maximum < 1e6:
        words.append(f"up to {maximum:g}")
    return f" ({', '.join(words)})" if words else ""


def _default(key: str, value: Schema, definition: Schema) -> str:
    if key in definition.get("required", []):
        return "required"
    default = value.get("default")
    return "" if default in (None, "") else f"`{_as_text(default)}`"


def _as_text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _cell(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")
