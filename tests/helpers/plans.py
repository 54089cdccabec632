"""Problem files of this repository, and plans, each solved once for all tests of a package.

Workers share them as files in the folder that ``conftest`` names: below ``.pytest_cache`` by the
contents of package and problems, so that tests of an unchanged package plan nothing twice; a
temporary one in CI.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict

ROOT = Path(__file__).parents[2]
PROBLEMS = ROOT / "problems"
GOOD, BAD, INFEASIBLE = (
    sorted((PROBLEMS / folder).glob("*.yaml")) for folder in ("", "bad", "infeasible")
)
FOLDER = "HITCHOPT_TESTED_PLANS"


@cache
def planned(name: str) -> ho.Plan:
    """Return the plan of ``problems/NAME.yaml``."""
    return _stored(name.replace("/", "."), lambda: ho.solve(PROBLEMS / f"{name}.yaml"))


def planned_of(problem: Mapping[str, object]) -> ho.Plan:
    """Return the plan of a problem's mapping."""
    text = json.dumps(problem, sort_keys=True)
    key = hashlib.sha256(text.encode()).hexdigest()[:16]
    return _stored(key, lambda: ho.solve(problem_from_dict(problem)))


def _stored(key: str, plan_now: Callable[[], ho.Plan]) -> ho.Plan:
    """Return the plan that is stored, or a new one, which is stored then."""
    path = Path(os.environ[FOLDER]) / f"{key}.pickle"
    if path.exists():
        found = pickle.loads(path.read_bytes())
        assert isinstance(found, ho.Plan)
        return found
    plan = plan_now()
    path.parent.mkdir(parents=True, exist_ok=True)
    own = path.with_suffix(f".{os.getpid()}")
    own.write_bytes(pickle.dumps(plan))
    own.replace(path)
    return plan


def header(path: Path, word: str) -> str:
    """What the comment ``# word: …`` of a problem says."""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"# {word}: "):
            return line.removeprefix(f"# {word}: ")
    raise KeyError(f"{path} has no comment '# {word}: …'")


def digest() -> str:
    """Return what tells this package and these problems from others."""
    found = hashlib.sha256()
    for folder in ("hitchopt", "problems"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in {".py", ".yaml", ".svg", ".dxf", ".csv", ".json"}:
                found.update(path.read_bytes())
    return found.hexdigest()[:16]
