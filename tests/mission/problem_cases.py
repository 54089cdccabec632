"""The problem files of this repository, and what their headers say of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
from plans import PROBLEMS, ROOT

from hitchopt.geometry import ConvexArc
from hitchopt.mission.keys import problem_schema
from hitchopt.mission.problem import HitchStart, Problem
from problems.random_morph import random_convex_polygon

GOOD = sorted(PROBLEMS.glob("*.yaml"))
BAD = sorted((PROBLEMS / "bad").glob("*.yaml"))
INFEASIBLE = sorted((PROBLEMS / "infeasible").glob("*.yaml"))
VALIDATOR = jsonschema.Draft202012Validator(problem_schema())
TEMPLATE = ROOT / "hitchopt" / "mission" / "template.yaml"


def header(path: Path, word: str) -> str:
    """What the comment ``# word: …`` of a bad problem says."""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"# {word}: "):
            return line.removeprefix(f"# {word}: ")
    raise KeyError(f"{path} has no comment '# {word}: …'")


def hitch_start(problem: Problem) -> HitchStart:
    """The start of a problem that begins with a hitch."""
    assert isinstance(problem.start, HitchStart)
    return problem.start


def triangle() -> dict[str, object]:
    """A problem with every section, nothing zero, one or at the origin that need not be."""
    kinds = [{"stiffness": 4.75, "integral": True, "feed_forward": False, "mass": 0.14}]
    polygon = [[2.0, 0.2], [1.6, 1.7], [2.4, 1.7]]
    return {
        "title": "Off the origin",
        "team": {
            **{"robots": 3, "topology": "closed", "cable_length": [2.4, 2.5, 2.6]},
            **{"cable_density": 0.003, "cable_friction": 0.05, "tension": [0.4, 0.45, 0.5]},
            "quadrotor": [{"mass": 0.132, "max_thrust": 2.6}, *kinds, {"max_thrust": 2.8}],
        },
        "limits": {
            **{"speed": 0.9, "acceleration": 1.9, "jerk": 19, "tilt_deg": 40},
            **{"body_rate_deg": 150, "vertex_speed": 0.4, "leg": 0.16, "duration": 60},
        },
        "separation": {"radius": 0.11, "height": 0.29, "cable": 0.09, "crossing": 0},
        "arena": {"lower": [-1, -2, 0.1], "upper": [5, 4, 3.3]},
        "start": {"hitch": {"polygon": polygon, "altitude": 1.3, "legs": [0.4, 0.7, 0.45]}},
        "mission": [
            {"morph": {"polygon": [[2, 0.7], [1.6, 1.7], [2.4, 1.7]], "legs": "balanced"}},
            {"hold": {"seconds": 1.5}},
            {"morph": {"polygon": [[2.1, 0.6], [1.5, 1.8], [2.4, 1.6]], "duration": 7.5}},
            {"move_vertex": {"vertex": 2, "by": [0.1, 0.05], "legs": "spread", "duration": 3.5}},
            {"move_edge": {"edge": 1, "to": [[1.6, 1.7], [2.4, 1.75]], "blend": True}},
            {"adjust": {"legs": [0.5, 0.6, 0.45]}},
            {"follow_vertex": {"vertex": 0, "path": [[0, 2.1, 0.6], [3.5, 2.0, 0.7]]}},
            {"transport": {"to": [2.0, 1.2, 1.6], "yaw_deg": -30, "duration": 9}},
        ],
    }


def random_chain(n: int, seed: int, tension: bool = True) -> dict[str, Any]:
    """A run of n edges of a random (n + 3)-gon, bent a little, turned and shifted."""
    rng = np.random.default_rng([n, seed])
    polygon = random_convex_polygon(n + 3, 1.3, rng, 0.15).translated(rng.uniform(-2.0, 2.0, 2))
    first = ConvexArc(polygon.vertices[: n + 1])
    centre = first.centroid
    second = first.translated(-centre).rotated(rng.uniform(-0.3, 0.3))
    second = second.scaled(rng.uniform(0.95, 1.05)).translated(centre + rng.uniform(-0.4, 0.4, 2))
    longest = np.maximum(first.edge_lengths, second.edge_lengths)
    return {
        "team": {
            "robots": n,
            "topology": "open",
            "cable_length": (longest + rng.uniform(0.65, 0.7, n)).round(4).tolist(),
            "tension": rng.uniform(0.4, 0.42, n).round(4).tolist() if tension else 0.4,
        },
        "start": {"hitch": {"polygon": first.vertices.round(6).tolist(), "altitude": 1.1}},
        "mission": [{"morph": {"polygon": second.vertices.round(6).tolist()}}],
    }
