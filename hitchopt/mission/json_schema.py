"""The JSON Schema of a problem file, for editors; made from the models that read the file.

``python -m hitchopt.mission.json_schema`` writes it anew beside this module.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from hitchopt.mission.file_models import ProblemKeys
from hitchopt.mission.schema import Keys
from hitchopt.mission.swarm_schema import SwarmKeys

DIALECT = "https://json-schema.org/draft/2020-12/schema"

KINDS: tuple[type[Keys], ...] = (ProblemKeys, SwarmKeys)
"""Models of a whole file."""

SCHEMA_FILE = Path(__file__).with_name("problem.schema.json")
"""Where the package keeps it."""


class _Untitled(GenerateJsonSchema):
    """A generator without titles that only repeat a key's or a model's name."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002
        return False


def problem_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a problem file: of a hitch, or of single drones."""
    _, schema = models_json_schema(
        [(model, "validation") for model in KINDS], schema_generator=_Untitled
    )
    for definition in schema["$defs"].values():
        del definition["title"]
    forms = [{"$ref": f"#/$defs/{model.__name__}"} for model in KINDS]
    return {"$schema": DIALECT, "title": "hitchopt problem file", "anyOf": forms, **schema}


@cache
def kind_schema(model: type[Keys]) -> dict[str, Any]:
    """Return the JSON Schema of one of the KINDS alone, or of another model of a file."""
    if model not in KINDS:
        return model.model_json_schema(schema_generator=_Untitled)
    schema = problem_schema()
    return {"$ref": f"#/$defs/{model.__name__}", "$defs": schema["$defs"]}


def schema_text() -> str:
    """Return the JSON Schema as the package's file holds it."""
    return json.dumps(problem_schema(), indent=2, ensure_ascii=False) + "\n"


def entries_at(schema: dict[str, Any], path: Sequence[str | int]) -> list[dict[str, Any]]:
    """Return what the schema says of the value at ``path``, one entry per form."""
    found = _forms(schema, schema)
    for part in path:
        if isinstance(part, int):
            inner = [form["items"] for form in found if "items" in form]
        else:
            inner = [entry for form in found for entry in _named(form, part)]
        found = [form for entry in inner for form in _forms(schema, entry)]
    return found


def _named(form: dict[str, Any], part: str) -> list[Any]:
    """Return the schema of a mapping's key; of mappings whose keys users name, any key's."""
    if part in form.get("properties", {}):
        return [form["properties"][part]]
    return list(form.get("patternProperties", {}).values())


def _forms(schema: dict[str, Any], entry: dict[str, Any]) -> list[dict[str, Any]]:
    if "$ref" in entry:
        entry = {**schema["$defs"][entry["$ref"].rsplit("/", 1)[1]], **entry}
        del entry["$ref"]
    choices = [*entry.get("oneOf", ()), *entry.get("anyOf", ())]
    if not choices:
        return [entry]
    return [form for choice in choices for form in _forms(schema, choice)]


if __name__ == "__main__":
    SCHEMA_FILE.write_text(schema_text(), encoding="utf-8")
