"""The reference of the problem file, from its JSON Schema."""

from __future__ import annotations

import json
import re

from hitchopt.mission.loading import problem_schema
from hitchopt.values.fields import Schema

KEYS = ("title", "team", "teams", "limits", "separation", "arena", "objects", "keep_out", "start")
"""Keys of a whole file that come first, in this order."""

INTRODUCTION = """# Problem file

A problem file is YAML with the keys of {ref}`one of three kinds <keys-problem>`: a team with cables and its
mission, {ref}`single drones <keys-swarmproblem>`, or {ref}`several teams <keys-teamsproblem>`. Every key that is not listed is an error. Lengths are in
metres, times in seconds, angles in degrees where a key ends in `_deg`. `hitchopt init` writes a file to start
from, and `hitchopt init --schema` a JSON Schema by which editors complete and check keys.
"""

HEADINGS = {
    "Problem": "A team with cables",
    "SwarmProblem": "Single drones",
    "TeamsProblem": "Several teams",
    "ObjectKeys": "Objects",
    "Step": "Steps",
}
"""Headings that are not definitions' names; those of whole files come first."""


def write_schema_page() -> str:
    """Return the page: one section and one table of keys for every definition of the schema."""
    definitions = problem_schema()["$defs"]
    sections: dict[str, str] = {}

    def add(name: str, level: str) -> None:
        """Add the section of a definition, then those of the definitions of its keys."""
        if name not in sections:
            sections[name] = _section(name, level, definitions[name])
            for key in _keys(definitions[name]) or [definitions[name]]:
                for each in re.findall(r"#/\$defs/(\w+)", json.dumps(key)):
                    add(each, "##" if name.endswith("Problem") else "###")

    for name in list(HEADINGS)[:3]:
        add(name, "##")
    return "\n".join([INTRODUCTION, *sections.values()])


def heading(name: str) -> str:
    """Return the heading of a definition: its name in words, without the ``Keys`` at its end."""
    words = "".join(f" {c.lower()}" if c.isupper() else c for c in name.removesuffix("Keys"))
    return HEADINGS.get(name, words.strip().capitalize())


def _keys(definition: Schema) -> list[tuple[str, Schema]]:
    """Return a definition's keys with their schemas, the first ones in the order of ``KEYS``."""
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
    """Return the values that a schema admits, in words; definitions are links."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"{{ref}}`{heading(name)} <keys-{name.lower()}>`"
    if "const" in value:
        return f"`{_shown(value['const'])}`"
    if "enum" in value:
        return " or ".join(f"`{_shown(each)}`" for each in value["enum"])
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
    least, most = value.get("minItems"), value.get("maxItems")
    items = in_words(value["items"])
    if items.startswith(("number", "integer", "list")) or items[:1].isdigit():
        first, _, rest = items.partition(" ")
        items = f"lists of {items}" if items[:1].isdigit() else f"{first}s {rest}".strip()
    return f"{least} {items}" if least is not None and least == most else f"list of {items}"


def _range(value: Schema) -> str:
    """Return the bounds that say something; those of the order of 1e9 only catch mistakes."""
    least, above = value.get("minimum"), value.get("exclusiveMinimum")
    most, below = value.get("maximum"), value.get("exclusiveMaximum")
    words = []
    if above is not None or (least is not None and 0.0 < least <= 1e-6):
        words.append(f"above {above or 0:g}")
    elif least is not None and abs(least) < 1e8:
        words.append(f"from {least:g}")
    if below is not None and below < 1e4:
        words.append(f"below {below:g}")
    elif most is not None and most < 1e6:
        words.append(f"up to {most:g}")
    return f" ({', '.join(words)})" if words else ""


def _default(key: str, value: Schema, definition: Schema) -> str:
    if key in definition.get("required", []):
        return "required"
    default = value.get("default")
    return "" if default in (None, "") else f"`{_shown(default)}`"


def _shown(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _cell(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")
