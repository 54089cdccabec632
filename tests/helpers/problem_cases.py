"""A problem with every section, and the schema of all."""

from __future__ import annotations

import jsonschema

from hitchopt.mission.loading import problem_schema
from hitchopt.mission.problem import Problem
from hitchopt.mission.starts import HitchStart
from tests.helpers.plans import ROOT

VALIDATOR = jsonschema.Draft202012Validator(problem_schema())
TEMPLATE = ROOT / "hitchopt" / "mission" / "template.yaml"


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
