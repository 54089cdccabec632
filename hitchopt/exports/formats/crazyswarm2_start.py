"""Files of a Crazyswarm2 fleet that go with its trajectories: settings, a script, a note."""

from __future__ import annotations

import json
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


SCRIPT = '''#!/usr/bin/env python3
"""Flies the trajectories in this file's folder in step: {title}.
{place}
Arms, takes off, goes to the first points, uploads, starts all drones by one broadcast, and hovers
at the end. There, Enter lands the drones; "stay" leaves them hovering for the next part, whose
fly.py is started with --from-here. Every drone has one trajectory, uploaded at offset 0.

A drone that hovers at the end of a trajectory still evaluates it from memory. An upload overwrites
that memory, and the setpoint would jump. goTo flies a piece of its own, so it comes first.
"""

import sys
from pathlib import Path

import numpy as np
from crazyflie_py import Crazyswarm
from crazyflie_py.uav_trajectory import Trajectory

FRAME = {frame!r}
DURATION = {duration!r}  # [s]
HEADING = {heading!r}  # [rad]
FIRST = {first}  # [m], where every drone's trajectory begins
ARM, TAKEOFF, SETTLE, GO = 1.0, 3.0, 2.0, 4.0  # [s]


def main():
    swarm = Crazyswarm()
    clock, everyone = swarm.timeHelper, swarm.allcfs
    drones = {{name: everyone.crazyfliesByName[name] for name in FIRST}}
    trajectories = {{name: Trajectory() for name in FIRST}}
    for name, trajectory in trajectories.items():
        trajectory.loadcsv(Path(__file__).parent / f"{{name}}.csv")
    if "--from-here" not in sys.argv:
        for drone in drones.values():
            if hasattr(drone, "arm"):  # the Brushless needs it; others arm themselves
                drone.arm(True)
        clock.sleep(ARM)
        everyone.takeoff(targetHeight={height!r}, duration=TAKEOFF)
        clock.sleep(TAKEOFF + SETTLE)
    for name, drone in drones.items():
        drone.goTo(np.array(FIRST[name]), HEADING, GO)
    clock.sleep(GO + SETTLE)
    for name, drone in drones.items():  # not before goTo: see above
        drone.uploadTrajectory(0, 0, trajectories[name])  # trajectory 0 at offset 0
    clock.sleep(1.0)
    # One broadcast for all; relative=False: the polynomials are in the frame's coordinates.
    everyone.startTrajectory(0, timescale=1.0, reverse=False, relative=False)
    clock.sleep(DURATION + 1.0)
    answer = input("hovering; Enter lands all drones where they are, stay leaves them hovering: ")
    if answer.strip() == "stay":
        return
    everyone.land(targetHeight={land!r}, duration=4.0)
    clock.sleep(5.0)


if __name__ == "__main__":
    main()
'''


def fly_script(task: Task, first: Array, last: Array, duration: float) -> str:
    """Return fly.py.

    Parameters
    ----------
    task: the plan, or a part of it.
    first, last: (D, 3) [m], where the trajectories begin and end.
    duration: of the trajectories [s].
    """
    places = {n: [round(x, 6) for x in p] for n, p in zip(task.names, first.tolist(), strict=True)}
    return SCRIPT.format(
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

NOTE = """{title}
{place}
One polynomial trajectory per drone (NAME.csv: duration [s], then powers of x, y, z [m] and
yaw [rad]), frame {frame}, {duration:.3f} s. crazyflies.yaml says who flies; put it where your
crazyswarm2 launch looks for it{placeholders}. fly.py flies them.

To start in step by other means:
 1. arm the drones that need it (Crazyflie 2.1 Brushless), and take off;
 2. goTo (absolute) to the first point of each trajectory, and wait, also where drones hover there;
 3. only then upload one trajectory per drone, id 0, at piece offset 0. A drone that hovers at the
    end of a trajectory still evaluates it from the memory that an upload overwrites: its setpoint
    would jump, by metres. goTo flies a piece of its own;
 4. startTrajectory(0, relative=False), as one broadcast to all drones. With relative=True, which
    is the default, every drone would add its own position, and the team would fly apart.

{pull}
Drones stand below their first points before take-off: mind the cables there.
Before every flight: hitchopt lint on this folder.
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
    return NOTE.format(
        title=task.title or "A plan of hitchopt",
        place=PLACE.format(place=task.part) if task.part else "",
        frame=task.frame.name,
        duration=duration,
        placeholders="" if task.fleet.given else hint,
        pull=HELD_PULL if task.options.hold_tension else NO_PULL,
    )
