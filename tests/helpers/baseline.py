"""Durations and figures of this repository's problems when ``baseline.json`` was written.

A change of structure must not change them. Where a planner is meant to plan otherwise, write them
anew with ``python -m tests.helpers.baseline`` and say why in the commit.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from tests.helpers.plans import GOOD, ROOT

FILE = ROOT / "tests" / "cli" / "baseline.json"

SLOW = ("circle_64", "circle_200")  # Problems that take longer to plan than a test should
SWARMS = [
    path for path in sorted((ROOT / "problems" / "swarms").glob("*.yaml")) if path.stem not in SLOW
]

# Largest difference of a figure, relative to it, and in its unit; the larger counts. Bounds come
# that close to what is attained, and where a search stops depends on rounding and on its formula
RELATIVE, ABSOLUTE = 1e-4, 2e-7
DURATION = 1e-6  # The same of durations, relative
# Largest difference of ``stoppable``, relative: whether a duration that is tried keeps a limit
# may depend on rounding, and with it which of two neighbouring ones, a quarter apart, is found
SEARCHED = 0.25
# [m] Largest difference of ``continuity``, which is rounding alone and differs between
# processors: a thousandth of its limit
ROUNDING = 1e-9


def figures_of(certificate: Any) -> dict[str, Any]:
    """Return duration and worst values of a certificate as ``certificate.json`` holds it."""
    worst = {check["name"]: check["worst"] for check in certificate["checks"]}
    return {"duration": certificate["duration"], "worst": worst}


def differences(found: Any, path: Path) -> list[str]:
    """Return the figures of a certificate that are not those of the baseline, in words."""
    known = json.loads(FILE.read_text(encoding="utf-8"))[path.stem]
    here = figures_of(found)
    told = []
    if abs(here["duration"] - known["duration"]) > DURATION * known["duration"]:
        told.append(f"duration {here['duration']} instead of {known['duration']}")
    if missing := known["worst"].keys() - here["worst"].keys():
        told.append(f"no {', '.join(sorted(missing))}")
    for name, value in known["worst"].items():
        now = here["worst"].get(name)
        if now is None or value is None:  # nothing was counted
            same = now is value
        elif name == "continuity":
            same = abs(now - value) <= ROUNDING
        else:
            share = SEARCHED if name == "stoppable" else RELATIVE
            same = abs(now - value) <= max(share * abs(value), ABSOLUTE)
        if not same:
            told.append(f"{name} {now} instead of {value}")
    return told


def _planned(path: Path) -> dict[str, Any]:
    import hitchopt as ho

    return figures_of(ho.solve(path).certificate.to_dict())


def main() -> None:
    """Plan all problems and write their figures."""
    paths = [*GOOD, *SWARMS]
    with ProcessPoolExecutor(2) as pool:
        found = dict(zip((path.stem for path in paths), pool.map(_planned, paths), strict=True))
    text = json.dumps(found, indent=1, sort_keys=True)
    FILE.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(f"{len(found)} problems written to {FILE.name}\n")


if __name__ == "__main__":
    main()
