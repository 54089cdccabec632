"""What is wrong with a problem file, in words, and its JSON Schema; both from the file's keys."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from hitchopt.errors import InputError, one_or_all
from hitchopt.mission.keys import ProblemKeys, SwarmKeys
from hitchopt.steps.step_keys import EACH, FAULT, MAPPING, MIN_QUANTITY, ONE, WORD, Keys
from hitchopt.storage.yaml_file import key_path

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
    schema = json.loads(SCHEMA_FILE.read_text("utf-8"))
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


Schema = dict[str, Any]


class _Words(NamedTuple):
    """How a message ends."""

    bound: str
    remedy: str


class _Missing:
    """Stands for the value of a key that is not there."""

    def __repr__(self) -> str:
        return "(missing)"


def translated(error: ValidationError, model: type[Keys] = ProblemKeys) -> InputError:
    """Return what pydantic found in a file of one of the kinds, in this package's words."""
    schema = kind_schema(model)
    return one_or_all([_translated(entry, schema) for entry in error.errors(include_url=False)])


def _translated(entry: Any, schema: Schema) -> InputError:
    path = [part for part in entry["loc"] if part not in {ONE, EACH, WORD, MAPPING}]
    value: object = entry["input"]
    kind: str = entry["type"]
    if kind == "missing":
        value = _Missing()
    words = _words(kind, entry.get("ctx", {}), path, value, schema)
    return InputError(key_path(path) or "problem", value, words.bound, words.remedy)


def _words(
    kind: str, ctx: dict[str, Any], path: list[str | int], value: object, schema: Schema
) -> _Words:
    """Return bound and remedy for pydantic's error of type ``kind``."""
    not_finite = isinstance(value, float) and not math.isfinite(value)
    if kind == "finite_number" or not_finite:
        words = _Words("finite", "nan and inf are no quantities; give a plain number")
    elif kind == FAULT:
        words = _Words(ctx["bound"], ctx["remedy"])
    elif kind == "extra_forbidden":
        forms = entries_at(schema, path[:-1])
        known = [key for form in forms for key in form.get("properties", {})]
        words = _Words("a known key", _nearest(str(path[-1]), known))
    elif kind == "missing":
        words = _Words("given", f"add {path[-1]}: {_example(path, schema)}")
    elif kind in {"too_short", "too_long", "string_too_long"}:
        remedy = "make it longer" if kind == "too_short" else "shorten it"
        words = _Words(_counted(path, schema), remedy)
    elif kind == "literal_error":
        known = [str(word) for form in entries_at(schema, path) for word in form.get("enum", ())]
        remedy = _nearest(str(value), known)
        if path[-1] == "by" and isinstance(value, int | float):
            remedy = f"{remedy}; a height belongs to lift: {value:g}"
        words = _Words(_type_at(path, schema), remedy)
    elif kind.startswith(("greater_than", "less_than")):
        words = _range(ctx, value)
    else:
        words = _Words(_type_at(path, schema), _type_remedy(path, value, schema))
    return words


def _range(ctx: dict[str, Any], value: object) -> _Words:
    if "lt" in ctx or "le" in ctx:
        bound = f"below {ctx['lt']:g}" if "lt" in ctx else f"at most {ctx['le']:g}"
        return _Words(bound, "give a smaller number")
    least = ctx["ge"]
    if least == MIN_QUANTITY and isinstance(value, int | float) and value <= 0:
        return _Words("greater than 0", "give a positive number")
    return _Words(f"at least {least:g}", "give a larger number")


def _nearest(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word[:60], known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"use one of {', '.join(known)}"


def _example(path: list[str | int], schema: Schema) -> str:
    for form in entries_at(schema, path[:-1]):
        entry = form.get("properties", {}).get(path[-1], {})
        for example in entry.get("examples", ()):
            return json.dumps(example).replace('"', "")
    return "…"


def _counted(path: list[str | int], schema: Schema) -> str:
    for form in entries_at(schema, path):
        least, most = form.get("minItems", 0), form.get("maxItems", form.get("maxLength", math.inf))
        if least == most:
            return f"a list of {least} numbers"
        if "maxLength" in form:
            return f"at most {most} characters long"
        if "minItems" in form:
            bounded = f" and at most {most}" if most < math.inf else ""
            return f"a list of at least {least}{bounded} entries"
    return "a list of another length"


_TYPES = {
    "number": "a number",
    "integer": "a whole number",
    "string": "text",
    "boolean": "true or false",
    "array": "a list",
    "object": "a mapping",
    "null": "null",
}

_REMEDIES = {
    "object": "write its keys indented below it, or in braces",
    "integer": "write it without a fraction",
    "number": "give a plain number in SI units",
    "array": "write a list in brackets",
    "boolean": "write true or false",
    "string": "put it in quotes if it is meant as text",
}
"""Remedies of a wrong type, by the types that a key may have; the first one counts."""


def _type_at(path: list[str | int], schema: Schema) -> str:
    names: list[str] = []
    for form in entries_at(schema, path):
        name = " or ".join(form["enum"]) if "enum" in form else _TYPES.get(form.get("type", ""), "")
        if name == "a mapping" and "properties" in form:
            name = f"a mapping with keys of {', '.join(form['properties'])}"
        elif name == "a list" and "minItems" in form:
            name = _counted(path, schema) if form["minItems"] == form.get("maxItems") else "a list"
        if name and name not in names:
            names.append(name)
    return ", or ".join(names) if names else "of another type"


def _type_remedy(path: list[str | int], value: object, schema: Schema) -> str:
    types = {form.get("type") for form in entries_at(schema, path)}
    if value is None:
        remedy = "remove the key, or write its value after it"
    elif isinstance(value, str) and types & {"number", "integer"}:
        remedy = "remove the quotes" if _is_number(value) else "give a plain number in SI units"
    else:
        remedy = next(_REMEDIES[name] for name in _REMEDIES if name in types or name == "string")
    return remedy


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
