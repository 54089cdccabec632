"""Lies about hitches that are laid: order, sense and states."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plans import planned

from hitchopt import verify as second

Flags = NDArray[np.bool_]

NAMES = [phase.name for phase in planned("lay_triangle").phases]


def at(names: tuple[str, ...]) -> Flags:
    """Which pieces are in phases of these names."""
    motion = planned("lay_triangle").motion
    found: Flags = np.isin(np.array(NAMES)[motion.phase_of_piece], names)
    return found


def state(names: tuple[str, ...], word: str) -> Callable[[Any, Any], None]:
    def change(settings: Any, _: Any) -> None:
        for phase in settings["phases"]:
            phase["state"] = word if phase["name"] in names else phase["state"]

    return change


def from_below(_: Any, arrays: Any) -> None:
    """Cable 2 comes from as far below as it does from above."""
    laid = at(("slide in", "lay"))
    z = arrays["drones"][:, 4:6, 2]
    lying = z[np.flatnonzero(laid)[-1], :, -1]
    z[laid] = 2.0 * lying[:, None] - z[laid]


def mirrored(_: Any, arrays: Any) -> None:
    """Every pair rolls in the other sense."""
    rolls = at(("roll",))
    z, altitude = arrays["drones"][:, :, 2], arrays["vertices"][-1, 0, 2, -1]
    z[rolls] = 2.0 * altitude - z[rolls]


def backward(_: Any, arrays: Any) -> None:
    """Pairs roll from the clasps to where cables lie across."""
    rolls = at(("roll",))
    arrays["drones"][rolls] = arrays["drones"][rolls][::-1, ..., ::-1]


def apart(_: Any, arrays: Any) -> None:
    """Cables stay 5 cm over each other."""
    laid = at(("slide in", "lay"))
    arrays["drones"][laid, :, 2] += 0.05 * np.array([0, 0, 1, 1, 2, 2])[:, None]


def slack(_: Any, arrays: Any) -> None:
    """A drone is 2 mm nearer to its partner."""
    laid, q, r = at(("slide in", "lay")), arrays["drones"][:, 0], arrays["drones"][:, 1]
    way = r - q
    q[laid] += 0.002 * (way / np.linalg.norm(way, axis=1, keepdims=True))[laid]


def drift(_: Any, arrays: Any) -> None:
    """A vertex moves by 1 mm while pairs roll."""
    arrays["vertices"][np.flatnonzero(at(("roll",)))[20], 0, 0] += 1e-3


LIES = {
    "from below": (from_below, "interlacing"),
    "mirrored": (mirrored, "interlacing"),
    "backward": (backward, "interlacing"),
    "apart": (apart, "interlacing"),
    "slack": (slack, "cable_length"),
    "drift": (drift, "story"),
    "an open hitch": (state(("tension", "roll"), "hitched"), "contact"),
    "hanging over each other": (state(("slide in", "lay"), "hanging free"), "crossing"),
    "laid at once": (state(("draw taut",), "being laid"), "cable_length"),
}


@pytest.mark.parametrize("name", LIES)
def test_lies_are_found(name: str, tmp_path: Path) -> None:
    change, row = LIES[name]
    planned("lay_triangle").save(tmp_path, rate=10.0)
    path = tmp_path / "plan.npz"
    with np.load(path) as file:
        arrays = {key: file[key].copy() for key in file.files}
    settings = json.loads(str(arrays["settings"]))
    change(settings, arrays)
    np.savez(path, **{**arrays, "settings": np.array(json.dumps(settings))})
    found = {each.name for each in second.verify(path) if each.verdict != "proven"}
    assert row in found
