"""Files of a Crazyswarm2 fleet that go with its trajectories: settings, a script, a note."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

import numpy as np

from hitchopt.exports.formats.format import Task
from hitchopt.values import Array

DEFAULT_TYPE: dict[str, Any] = {
    "motion_capture": {
        "tracking": "librigidbodytracker",
        "marker": "default_single_marker",
        "dynamics": "default",
    },
    "big_quad": False,
    "battery": {"voltage_warning": 3.8, "voltage_critical": 3.7},
}
"""Settings of every type that the fleet file does not describe."""

FOR_ALL: dict[str, Any] = {
    "firmware_params": {
        "commander": {"enHighLevel": 1},
        "stabilizer": {"estimator": 2, "controller": 2},
    },
    "broadcasts": {"num_repeats": 15, "delay_between_repeats_ms": 1},
}
"""Kalman filter, Mellinger's controller, the high-level commander that flies trajectories."""

LANDED = 0.04
"""Height at which landing cuts the motors [m], unless drones hover below it."""


def settings_text(task: Task, first: Array) -> str:
    """Return crazyflies.yaml, fileversion 3; drones stand on the floor below where they start.

    Parameters
    ----------
    task: with fleet and frame.
    first: (D, 3) [m], where the trajectories begin.
    """
    lines = [
        f"# frame: {task.frame.name}; drones wait on the floor below their trajectories' starts",
        "fileversion: 3",
        "",
        "robots:",
    ]
    for member, point in zip(task.fleet.members, first.tolist(), strict=True):
        lines += [
            f"  {member.name}:",
            "    enabled: true",
            f"    uri: {json.dumps(member.uri)}",
            # ROS refuses lists that mix integers and floats, so every number has a point.
            f"    initial_position: [{point[0]:.6f}, {point[1]:.6f}, 0.0]",
            f"    type: {json.dumps(member.type)}",
            f"    role: {member.role}  # in the plan",
        ]
    lines += ["", "robot_types:"]
    for name in dict.fromkeys(member.type for member in task.fleet.members):
        described = task.fleet.types.get(name, DEFAULT_TYPE)
        lines.append(f"  {json.dumps(name)}: {json.dumps(described)}")
    lines += ["", f"all: {json.dumps(task.fleet.settings or FOR_ALL)}", ""]
    return "\n".join(lines)


def fly_script(task: Task, first: Array, last: Array, duration: float) -> str:
    """Return fly.py.

    Parameters
    ----------
    task: the plan, or a part of it.
    first, last: (D, 3) [m], where the trajectories begin and end.
    duration: of the trajectories [s].
    """
    places = {n: [round(x, 6) for x in p] for n, p in zip(task.names, first.tolist(), strict=True)}
    return _template("fly_script.txt").format(
        title=task.title.replace("\\", " ").replace('"', "'") or "a plan of hitchopt",
        place=f"This is {task.part}.\n" if task.part else "",
        frame=task.frame.name,
        duration=duration,
        heading=task.frame.heading,
        first=json.dumps(places, indent=4),
        height=round(float(np.min(first[:, 2])), 3),
        land=min(LANDED, round(float(np.min(last[:, 2])), 3) + 0.0),
    )


PLACE = """
This is {place}.
Launch with part1/crazyflies.yaml and fly part1/fly.py, then every next part's fly.py --from-here.
Answer "stay" after all parts but the last.
"""


NO_PULL = """\
The cables' pull is not in the polynomials, and the on-board controller's integral does not find
it: that brings drones to their places, where any tension may be. Turn it off and export with
--hold-tension, or stream full states."""
"""What the note says of the cables' pull."""

HELD_PULL = """\
The polynomials are moved outward: drones without feed-forward of the cables' pull are where the
plan says. Turn the on-board controller's integral off, and set the gains that the export stated."""
"""What it says where set points hold the tension."""


def note_text(task: Task, duration: float) -> str:
    """Return README.txt."""
    hint = " (its radio addresses are placeholders: name yours with --fleet when exporting)"
    return _template("start_note.txt").format(
        title=task.title or "A plan of hitchopt",
        place=PLACE.format(place=task.part) if task.part else "",
        frame=task.frame.name,
        duration=duration,
        placeholders="" if task.fleet.given else hint,
        pull=HELD_PULL if task.options.hold_tension else NO_PULL,
    )


def _template(name: str) -> str:
    """Return the text of a file beside this module, with fields in braces."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")
