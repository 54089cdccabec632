"""Edits written into the mapping that a problem file holds."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Mapping
from typing import Any

from hitchopt.mission.repair import Edit


def edited(data: Mapping[str, Any], edits: Iterable[Edit]) -> dict[str, Any]:
    """Return a copy of a problem's mapping with the edits made.

    Parameters
    ----------
    data: with the keys of a problem file.
    edits: of a change, or read from a diagnosis.json.
    """
    result = copy.deepcopy(dict(data))
    for edit in edits:
        put(result, edit.key, edit.value)
    return result


def put(data: Any, key: str, value: object) -> None:
    """Set one value; ``key`` is a path such as ``mission[0].morph.duration``.

    Sections that are missing or empty are created.
    """
    *parents, last = _parts(key)
    place = data
    for part in parents:
        if isinstance(part, str) and place.get(part) is None:
            place[part] = {}
        place = place[part]
    place[last] = value


def _parts(key: str) -> list[str | int]:
    found = re.findall(r"\[(\d+)\]|([^.\[\]]+)", key)
    return [int(index) if index else name for index, name in found]
