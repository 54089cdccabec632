from __future__ import annotations

from typing import Any

import jsonschema
import pytest

from hitchopt.errors import InputError
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.wording import SCHEMA_FILE, problem_schema, schema_text

VALIDATOR = jsonschema.Draft202012Validator(problem_schema())


def test_the_shipped_schema_is_current() -> None:
    assert SCHEMA_FILE.name == "problem.schema.json"
    assert SCHEMA_FILE.read_text(encoding="utf-8") == schema_text()


def all_properties(schema: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    return [entry for model in schema["$defs"].values() for entry in model["properties"].items()]


def test_every_key_is_described_and_no_mapping_takes_others() -> None:
    schema = problem_schema()
    for name, entry in all_properties(schema):
        assert "description" in entry or "$ref" in entry, name
    for model in schema["$defs"].values():
        assert model["additionalProperties"] is False
        assert model["description"]


def test_defaults_are_shown_and_valid_themselves() -> None:
    schema = problem_schema()
    shown = {name: entry["default"] for name, entry in all_properties(schema) if "default" in entry}
    for name, value in {"speed": 1.0, "assign": "auto", "height": 0.3, "legs": None}.items():
        assert shown[name] == value
    limits = schema["$defs"]["LimitsKeys"]["properties"]
    assert limits["tilt_deg"]["default"] == 45.0
    VALIDATOR.evolve(schema={**limits["speed"]}).validate(shown["speed"])


@pytest.mark.parametrize("objects", [None, "tray"])
def test_names_are_keys_of_a_mapping(objects: object) -> None:
    given = {"team": {"robots": 3}, "objects": objects, "mission": [{"hold": {"seconds": 1.0}}]}
    with pytest.raises(InputError, match=r"(?m)^objects = .*: must be a mapping; "):
        problem_from_dict(given)
