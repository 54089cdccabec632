"""The formats by name, each imported when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from hitchopt.errors import InputError

if TYPE_CHECKING:
    from hitchopt.exports.formats.format import Format

HOMES = {
    "crazyswarm2": "crazyswarm2:Crazyswarm2",
    "compressed": "compressed:CompressedBytes",
    "skybrush": "skybrush:SkybrushShow",
    "skybrush_csv": "skybrush_csv:SkybrushCsv",
    "mavsdk_drone_show": "mavsdk:MavsdkDroneShow",
    "ros2bag": "ros2bag:Ros2Bag",
    "csv": "tables:CsvTable",
    "parquet": "tables:ParquetTable",
    "npz": "tables:NpzTable",
    "json": "tables:JsonTable",
    "gltf": "gltf:Gltf",
}
"""Module and class of every format."""


def format_of(name: str) -> Format:
    """Return the format of that name.

    Raises
    ------
    InputError: there is none.
    """
    if name not in HOMES:
        import difflib

        near = difflib.get_close_matches(name, HOMES, 1)
        remedy = f"did you mean {near[0]}?" if near else "hitchopt export --help tells them apart"
        raise InputError("--format", name, f"one of {', '.join(HOMES)}", remedy)
    module, _, kind = HOMES[name].partition(":")
    found: Format = getattr(import_module(f"hitchopt.exports.formats.{module}"), kind)()
    return found
