"""JSON that every reader takes, and that no writer breaks the reader with.

Written, every number that is not finite is null. Read, a file of any content is parsed or refused.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any


def write_strict_json(path: Path, content: dict[str, Any]) -> None:
    """Write the content, indented, in UTF-8.

    Raises
    ------
    OSError: the file cannot be written.
    """
    path.write_text(strict_json(content) + "\n", encoding="utf-8", newline="\n")


def strict_json(content: dict[str, Any]) -> str:
    """Return the text of the content, indented."""
    return json.dumps(_strict(content), indent=2, allow_nan=False, ensure_ascii=False)


def parsed_json(text: str | bytes) -> Any:
    """Return what the text says, every number as a float: one of 400 digits is infinite.

    Raises
    ------
    ValueError: it is no JSON, or nested too deeply.
    """
    try:
        return json.loads(text, parse_int=float)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _strict(value: Any) -> Any:
    """Return ``value`` with null for every number that is not finite."""
    if isinstance(value, dict):
        return {key: _strict(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
