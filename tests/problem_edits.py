"""Edits written into the mapping that a problem file holds."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from hitchopt.mission.repair import Edit
from hitchopt.storage.yaml_file import split_key


def edited(data: Mapping[str, Any], edits: Iterable[Edit]) -> dict[str, Any]:
    """Return a copy of a problem's mapping with the edits of a change, or of a diagnosis.json."""
    result = copy.deepcopy(dict(data))
    for edit in edits:
        put(result, edit.key, edit.value)
    return result


def put(data: Any, key: str, value: object) -> None:
    """Set one value at a path such as ``mission[0].morph.duration``; sections may be missing."""
    *parents, last = split_key(key)
    for part in parents:
        if isinstance(part, str) and data.get(part) is None:
            data[part] = {}
        data = data[part]
    data[last] = value
