from __future__ import annotations

from pathlib import Path

import pytest

from hitchopt.errors import FileError, InputError
from hitchopt.export.fleet import PER_RADIO, fleet_from_dict, placeholder_fleet, read_fleet

ROLES = ("q0", "r0")

DRONES = {
    "q0": {"name": "cf7", "uri": "radio://0/80/2M/E7E7E7E707", "type": "cf21"},
    "r0": {"name": "cf9", "uri": "radio://1/90/2M/E7E7E7E709"},
}


def test_a_fleet_file(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(
        "drones:\n"
        "  r0: {name: cf9, uri: radio://1/90/2M/E7E7E7E709}\n"
        "  q0: {name: cf7, uri: radio://0/80/2M/E7E7E7E707, type: cf21}\n"
        "types:\n  cf21: {big_quad: false}\n"
    )
    fleet = read_fleet(path, ROLES)
    assert [m.name for m in fleet.members] == ["cf7", "cf9"]
    assert [m.role for m in fleet.members] == ["q0", "r0"]
    assert [m.type for m in fleet.members] == ["cf21", "default"]
    assert fleet.types == {"cf21": {"big_quad": False}}
    assert fleet.given


def test_placeholders_have_names_and_addresses_of_their_own() -> None:
    fleet = placeholder_fleet([f"d{i}" for i in range(300)])
    assert len({member.uri for member in fleet.members}) == 300
    assert fleet.members[PER_RADIO].uri.startswith("radio://1/")
    assert not fleet.given


def changed(role: str, **keys: object) -> dict[str, object]:
    entry = {k: v for k, v in {**DRONES.get(role, {}), **keys}.items() if v is not None}
    return {"drones": {**DRONES, role: entry}}


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({}, r"drones = '\(missing\)': must be given"),
        ({"drones": {"q0": DRONES["q0"]}}, "drones = 'r0': must be named once"),
        (changed("q1", name="cf1", uri="radio://0/1/2M/E7"), "'q1': must be a drone of the plan"),
        (changed("q0", name=None), r"drones.q0.name = '\(missing\)'"),
        (changed("q0", name="cf 7"), "drones.q0.name = 'cf 7': must be letters"),
        (changed("q0", name="../up"), "drones.q0.name"),
        (changed("q0", name="CF9"), "must be of one drone only"),
        (changed("q0", uri="radio://1/90/2M/E7E7E7E709"), "uri = .* must be of one drone only"),
        (changed("q0", uri="E7E7E7E707"), "drones.q0.uri = 'E7E7E7E707': must be an address"),
        (changed("q0", channel=80), "drones.q0.channel = 80: must be a known key"),
        (changed("q0", name=7), "drones.q0.name = 7: must be text"),
    ],
)
def test_mistakes_are_told_by_key(data: dict[str, object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        fleet_from_dict(data, ROLES)


def test_a_list_is_no_fleet(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text("- q0\n")
    with pytest.raises(FileError, match="no mapping"):
        read_fleet(path, ROLES)
