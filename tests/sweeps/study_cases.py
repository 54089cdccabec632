"""The problem that studies of the tests vary."""

from __future__ import annotations

from typing import Any

PROBLEM: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"morph": {"polygon": [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}],
}
