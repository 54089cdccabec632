"""What is wrong with a problem file, in words, and its JSON Schema; both from the file's keys."""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from hitchopt.errors import InputError, one_or_all
from hitchopt.mission.keys import ProblemKeys, SwarmKeys
from hitchopt.steps.step_keys import EACH, FAULT, FLAG, MAPPING, MIN_QUANTITY, ONE, WORD, Keys
from hitchopt.storage.yaml_file import key_path

DIALECT = "https://json-schema.org/draft/2020-12/schema"

KINDS: tuple[type[Keys], ...] = (ProblemKeys, SwarmKeys)
"""Models of a whole file."""

SCHEMA_FILE = Path(__file__).with_name("problem.schema.json")
"""Where the package keeps it."""

Schema = dict[str, Any]


class _Untitled(GenerateJsonSchema):
    """A generator without titles that only repeat a key's or a model's name."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002
        return False


def problem_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of a problem file: of a hitch, or of single drones."""
    _, schema = models_json_schema(
        [(model, "validation") for model in KINDS], schema_generator=_Untitled
    )
    for definition in schema["$defs"].values():
        del definition["title"]
    forms = [{"$ref": f"#/$defs/{model.__name__}"} for model in KINDS]
    return {"$schema": DIALECT, "title": "hitchopt problem file", "anyOf": forms, **schema}


def schema_text() -> str:
    """Return the JSON Schema as the package's file holds it."""
    return json.dumps(problem_schema(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SCHEMA_FILE.write_text(schema_text(), encoding="utf-8")


@cache
def _schema_of(model: type[Keys]) -> Schema:
    """Return the JSON Schema of one of the KINDS alone, or of another model of a file."""
    if model not in KINDS:
        return model.model_json_schema(schema_generator=_Untitled)
    schema = json.loads(SCHEMA_FILE.read_text("utf-8"))
    return {"$ref": f"#/$defs/{model.__name__}", "$defs": schema["$defs"]}


def _properties_at(schema: Schema, path: Sequence[str | int]) -> dict[str, Schema]:
    """Return the keys that the mapping at a path may have, with what the schema says of each."""
    found = list(_forms(schema, schema))
    for part in path:
        inner = [
            form["items"] if isinstance(part, int) else _under(form, part)
            for form in found
            if ("items" in form if isinstance(part, int) else form.get("type") == "object")
        ]
        found = [form for entry in inner for form in _forms(schema, entry)]
    return {key: each for form in found for key, each in form.get("properties", {}).items()}


def _under(form: Schema, key: str) -> Schema:
    """Return what a schema says of a key, or of all names that users give."""
    others = [*form.get("patternProperties", {}).values(), form.get("additionalProperties")]
    found: Schema = form.get("properties", {}).get(key) or others[0] or {}
    return found


def _forms(schema: Schema, entry: Schema) -> Iterator[Schema]:
    """Yield the schemas that an entry may follow."""
    if "$ref" in entry:
        entry = schema["$defs"][entry["$ref"].rsplit("/", 1)[1]]
    choices = [*entry.get("oneOf", ()), *entry.get("anyOf", ())]
    for choice in choices:
        yield from _forms(schema, choice)
    if not choices:
        yield entry


class _Missing:
    """Stands for the value of a key that is not there."""

    def __repr__(self) -> str:
        return "(missing)"


NUMBER = "give a plain number in SI units"

WORDS = {
    "int_type": ("a whole number", "write it without a fraction"),
    "int_parsing_size": ("a smaller number", NUMBER),
    "float_type": ("a number", NUMBER),
    "string_type": ("text", "put it in quotes if it is meant as text"),
    "bool_type": ("true or false", "write true or false"),
    "list_type": ("a list", "write a list in brackets"),
    "dict_type": ("a mapping", "write its keys indented below it, or in braces"),
    "finite_number": ("finite", "nan and inf are no quantities; give a plain number"),
    "string_pattern_mismatch": ("of letters, digits, spaces, - and _", "use another name"),
    "string_too_short": ("a text", "write at least one character"),
    "string_too_long": ("at most {max_length} characters long", "shorten it"),
    "too_short": ("a list of at least {min_length} entries", "make it longer"),
    "too_long": ("a list of at most {max_length} entries", "shorten it"),
    "greater_than": ("above {gt:g}", "give a larger number"),
    "greater_than_equal": ("at least {ge:g}", "give a larger number"),
    "less_than": ("below {lt:g}", "give a smaller number"),
    "less_than_equal": ("at most {le:g}", "give a smaller number"),
    FAULT: ("{bound}", "{remedy}"),
}
"""Bound and remedy of pydantic's types of errors, filled with what they tell."""

ALIKE = {"int_from_float": "int_type", "model_type": "dict_type", "int_parsing": "int_type"}
"""Types of errors that have the words of others."""


def translated(error: ValidationError, model: type[Keys] = ProblemKeys) -> InputError:
    """Return what pydantic found in a file of one of the kinds, in this package's words."""
    schema = _schema_of(model)
    return one_or_all([_translated(entry, schema) for entry in error.errors(include_url=False)])


def _translated(entry: Any, schema: Schema) -> InputError:
    """Return one of pydantic's errors in this package's words."""
    forms = {ONE, EACH, WORD, MAPPING, FLAG}
    path = [part for part in entry["loc"] if part not in forms]
    kind, value, told = entry["type"], entry["input"], entry.get("ctx", {})
    kind = ALIKE.get(kind, kind)
    if isinstance(value, float) and not math.isfinite(value):
        kind = "finite_number"
    if kind == "missing":
        value, example = _Missing(), _properties_at(schema, path[:-1])[path[-1]].get("examples")
        shown = json.dumps(example[0]).replace('"', "") if example else "…"
        bound, remedy = "given", f"add {path[-1]}: {shown}"
    elif kind == "extra_forbidden":
        known = list(_properties_at(schema, path[:-1]))
        bound, remedy = "a known key", _nearest(str(path[-1]), known)
    elif kind == "literal_error":
        bound = told["expected"].replace("'", "")
        remedy = _nearest(str(value), bound.replace(" or ", ", ").split(", "))
    elif kind == "union_tag_invalid":
        bound = told["expected_tags"].strip("'").replace("', '", " or ")
        remedy = NUMBER if ONE in bound else f"write {bound}"
    else:
        bound, remedy = (words.format(**told) for words in WORDS[kind])
    if kind == "greater_than_equal" and told["ge"] == MIN_QUANTITY and value <= 0:
        bound, remedy = "greater than 0", "give a positive number"
    elif value is None:
        remedy = "remove the key, or write its value after it"
    elif ONE in bound and isinstance(value, str) and re.fullmatch(r"[-+.\deE]+", value):
        remedy = "remove the quotes"
    elif path[-1:] == ["by"] and isinstance(value, int | float):
        remedy = f"{remedy}; a height belongs to lift: {value:g}"
    return InputError(key_path(path) or "problem", value, bound, remedy)


def _nearest(word: str, known: Sequence[str]) -> str:
    """Return what was probably meant by a word, or what there is."""
    close = difflib.get_close_matches(word[:60], known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"use one of {', '.join(known)}"
