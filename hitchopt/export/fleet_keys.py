"""The schema of a fleet file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, ValidationError

from hitchopt.errors import InputError
from hitchopt.mission.plain import key_path, plain
from hitchopt.mission.schema import Keys


class DroneKeys(Keys):
    """One drone of the fleet."""

    name: str = Field(description="What files and topics call it", examples=["cf231"])
    uri: str = Field(
        description="Address of its radio",
        pattern=r"^(radio|usb|udp|tcp|serial)://\S+$",
        examples=["radio://0/80/2M/E7E7E7E7E7"],
    )
    type: str = Field(default="default", description="Its entry in types")


class FleetKeys(Keys):
    """Who flies the plan's drones."""

    drones: dict[str, DroneKeys] = Field(description="By the plan's names: q0, r0, q1, …")
    types: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="Settings of the types, copied into crazyflies.yaml"
    )


WORDS = {
    "missing": ("given", "add it"),
    "extra_forbidden": ("a known key", "drones have name, uri and type"),
    "string_pattern_mismatch": ("an address", "such as radio://0/80/2M/E7E7E7E7E7"),
    "string_type": ("text", "put it in quotes"),
}
"""Bound and remedy for the kinds of faults that fleet files have."""


def checked_keys(data: Mapping[str, Any]) -> FleetKeys:
    """Return the fleet of plain data.

    Raises
    ------
    InputError: keys or values that are wrong; the first of them is told.
    """
    try:
        return FleetKeys.model_validate(plain(data))
    except ValidationError as error:
        entry = error.errors(include_url=False)[0]
        value = "(missing)" if entry["type"] == "missing" else entry["input"]
        bound, remedy = WORDS.get(entry["type"], (entry["msg"], "see the fleet file's example"))
        raise InputError(key_path(entry["loc"]) or "fleet", value, bound, remedy) from None
