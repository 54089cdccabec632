from __future__ import annotations

from typing import Any

import jsonschema
import pytest

from hitchopt.errors import InputError
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.wording import SCHEMA_FILE, entries_at, problem_schema, schema_text

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


@pytest.mark.parametrize(
    ("path", "keys"),
    [
        (
            ["limits"],
            {
                *("speed", "acceleration", "jerk", "tilt_deg", "body_rate_deg", "reserve"),
                *("vertex_speed", "leg", "duration"),
            },
        ),
        (["team", "quadrotor"], {"mass", "max_thrust", "stiffness", "integral", "feed_forward"}),
        (["team", "quadrotor", 4], {"mass", "max_thrust", "stiffness", "integral", "feed_forward"}),
        (
            ["mission", 7, "morph"],
            {"polygon", "legs", "duration", "blend", "optimize", "tension"},
        ),
        (["mission", 7, "morph", "tension"], {"min", "max"}),
        (["mission", 7, "move_edge"], {"edge", "to", "by", "legs", "duration", "blend"}),
        (["mission", 7, "hold"], {"seconds"}),
        (["start", "hitch", "polygon", 1, 0], set()),
        (["nowhere"], set()),
    ],
)
def test_a_path_leads_to_its_keys(path: list[str | int], keys: set[str]) -> None:
    found = {key for way in entries_at(problem_schema(), path) for key in way.get("properties", ())}
    assert found == keys


@pytest.mark.parametrize("objects", [None, [{"circle": 0.1}], "tray", 3.0])
def test_names_are_keys_of_a_mapping(objects: object) -> None:
    given = {"team": {"robots": 3}, "objects": objects, "mission": [{"hold": {"seconds": 1.0}}]}
    with pytest.raises(InputError, match=r"(?m)^objects = .*: must be a mapping; "):
        problem_from_dict(given)
