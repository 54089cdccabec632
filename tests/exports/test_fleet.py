from __future__ import annotations

from pathlib import Path

import pytest

from hitchopt.errors import FileError, InputError
from hitchopt.exports.fleet import PER_RADIO, fleet_from_dict, placeholder_fleet, read_fleet

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
    ("data", "reported"),
    [
        ({}, r"drones = '\(missing\)': must be given"),
        ({"drones": {"q0": DRONES["q0"]}}, "drones = 'r0': must be named once"),
        (changed("q1", name="cf1", uri="radio://0/1/2M/E7"), "'q1': must be a drone of the plan"),
        (changed("q0", name=None), r"drones.q0.name = '\(missing\)'"),
        (changed("q0", name="cf 7"), "drones.q0.name = 'cf 7': must be letters"),
        (changed("q0", name="../up"), "drones.q0.name"),
        (changed("q0", name="On"), "no word of YAML"),
        (changed("q0", name="CF9"), "must be of one drone only"),
        (changed("q0", uri="radio://1/90/2M/E7E7E7E709"), "uri = .* must be of one drone only"),
        (changed("q0", uri="E7E7E7E707"), "drones.q0.uri = 'E7E7E7E707': must be an address"),
        (changed("q0", channel=80), "drones.q0.channel = 80: must be a known key"),
        (changed("q0", name=7), "drones.q0.name = 7: must be text"),
    ],
)
def test_mistakes_are_reported_by_key(data: dict[str, object], reported: str) -> None:
    with pytest.raises(InputError, match=reported):
        fleet_from_dict(data, ROLES)


ROBOTS: dict[str, dict[str, object]] = {
    "cf7": {"uri": "radio://0/80/2M/E7E7E7E707", "initial_position": [0, 0.5, 0], "role": "r0"},
    "q0": {"enabled": True, "uri": "radio://0/80/2M/E7E7E7E709", "type": "cf21"},
    "cf3": {"enabled": False, "uri": "radio://0/80/2M/E7E7E7E703", "type": "cf21"},
}


def test_robots_fly_their_roles_else_their_names() -> None:
    data = {"fileversion": 3, "robots": ROBOTS, "robot_types": {"cf21": {}}, "all": {"a": 1}}
    fleet = fleet_from_dict(data, ROLES)
    assert [(m.role, m.name) for m in fleet.members] == [("q0", "q0"), ("r0", "cf7")]
    assert [m.type for m in fleet.members] == ["cf21", "default"]
    assert (fleet.types, fleet.settings) == ({"cf21": {}}, {"a": 1})


@pytest.mark.parametrize(
    ("name", "keys", "reported"),
    [
        ("cf3", {"enabled": True}, r"robots = 'cf3': .* a robot's role tells which it flies"),
        ("cf3", {"enabled": True, "role": "r0"}, "robots.cf3.role = 'r0': .* and cf7 has it"),
        ("cf7", {"firmware_params": {}}, "robots.cf7.firmware_params = .*a known key"),
        ("cf7", {"uri": ROBOTS["q0"]["uri"]}, r"robots\.\w+\.uri = .* must be of one drone only"),
        ("cf7", {"uri": None}, "robots.cf7.uri"),
    ],
)
def test_mistakes_in_settings_are_reported_by_robot(
    name: str, keys: dict[str, object], reported: str
) -> None:
    robots = {**ROBOTS, name: {**ROBOTS[name], **keys}}
    with pytest.raises(InputError, match=reported):
        fleet_from_dict({"robots": robots}, ROLES)


def test_a_list_is_no_fleet(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text("- q0\n")
    with pytest.raises(FileError, match="no mapping"):
        read_fleet(path, ROLES)
