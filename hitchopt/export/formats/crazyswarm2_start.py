"""What a Crazyswarm2 fleet needs beside its trajectories: settings, a script, a note."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.export.formats.format import Task

Array = NDArray[np.float64]

DEFAULT_TYPE: dict[str, Any] = {
    "motion_capture": {
        "tracking": "librigidbodytracker",
        "marker": "default_single_marker",
        "dynamics": "default",
    },
    "big_quad": False,
    "battery": {"voltage_warning": 3.8, "voltage_critical": 3.7},
}
"""For every type that the fleet file does not describe."""

FOR_ALL: dict[str, Any] = {
    "firmware_params": {
        "commander": {"enHighLevel": 1},
        "stabilizer": {"estimator": 2, "controller": 2},
    },
    "broadcasts": {"num_repeats": 15, "delay_between_repeats_ms": 1},
}
"""Kalman filter, Mellinger's controller, the high-level commander that flies trajectories."""


def settings_text(task: Task, first: Array) -> str:
    """Return crazyflies.yaml, fileversion 3; drones stand on the floor below where they start.

    Parameters
    ----------
    task: with fleet and frame.
    first: (D, 3) [m], where the trajectories begin.
    """
    lines = [
        f"# frame: {task.room.frame}; drones wait on the floor below their trajectories' starts",
        "fileversion: 3",
        "",
        "robots:",
    ]
    for member, point in zip(task.fleet.members, first.tolist(), strict=True):
        lines += [
            f"  {member.name}:",
            "    enabled: true",
            f"    uri: {member.uri}",
            f"    initial_position: [{point[0]:.6g}, {point[1]:.6g}, 0.0]",
            f"    type: {json.dumps(member.type)}  # the plan's {member.role}",
        ]
    lines += ["", "robot_types:"]
    for name in dict.fromkeys(member.type for member in task.fleet.members):
        described = task.fleet.types.get(name, DEFAULT_TYPE)
        lines.append(f"  {json.dumps(name)}: {json.dumps(described)}")
    lines += ["", f"all: {json.dumps(FOR_ALL)}", ""]
    return "\n".join(lines)


SCRIPT = '''#!/usr/bin/env python3
"""Flies the trajectories beside this file in step: {title}.

Takes off, goes to the first points, starts all drones by one broadcast, and hovers at the end
until Enter is pressed; then it lands them. With --from-here the drones fly already, at the end of
the part before. Every drone has one trajectory, uploaded at offset 0.
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
TAKEOFF, SETTLE, GO = 3.0, 2.0, 4.0  # [s]


def main():
    swarm = Crazyswarm()
    clock, everyone = swarm.timeHelper, swarm.allcfs
    drones = {{name: everyone.crazyfliesByName[name] for name in FIRST}}
    for name, drone in drones.items():
        trajectory = Trajectory()
        trajectory.loadcsv(Path(__file__).parent / f"{{name}}.csv")
        drone.uploadTrajectory(0, 0, trajectory)  # trajectory 0 at offset 0
    clock.sleep(1.0)
    if "--from-here" not in sys.argv:
        everyone.takeoff(targetHeight={height!r}, duration=TAKEOFF)
        clock.sleep(TAKEOFF + SETTLE)
    for name, drone in drones.items():
        drone.goTo(np.array(FIRST[name]), HEADING, GO)
    clock.sleep(GO + SETTLE)
    # One broadcast for all; relative=False: the polynomials are in the room's coordinates.
    everyone.startTrajectory(0, timescale=1.0, reverse=False, relative=False)
    clock.sleep(DURATION + 1.0)
    input("hovering at the last points; Enter lands all drones where they are ")
    everyone.land(targetHeight=0.04, duration=4.0)
    clock.sleep(5.0)


if __name__ == "__main__":
    main()
'''


def fly_script(task: Task, first: Array, duration: float) -> str:
    """Return fly.py."""
    places = {n: [round(x, 6) for x in p] for n, p in zip(task.names, first.tolist(), strict=True)}
    return SCRIPT.format(
        title=task.title.replace("\\", " ").replace('"', "'") or "a plan of hitchopt",
        frame=task.room.frame,
        duration=duration,
        heading=task.room.heading,
        first=json.dumps(places, indent=4),
        height=round(float(np.min(first[:, 2])), 3),
    )


NOTE = """{title}

One polynomial trajectory per drone (NAME.csv: duration [s], then powers of x, y, z [m] and
yaw [rad]), frame {frame}, {duration:.3f} s. crazyflies.yaml says who flies; put it where your
crazyswarm2 launch looks for it{placeholders}. fly.py flies them.

To start in step by other means:
 1. upload one trajectory per drone, id 0, at piece offset 0;
 2. take off, then goTo (absolute) to the first point of each trajectory, and wait;
 3. startTrajectory(0, relative=False), as one broadcast to all drones. With relative=True, which
    is the default, every drone would add its own position, and the team would fly apart.

The cables' pull is not in the polynomials: the on-board controller has to find it by its integral.
Drones stand below their first points before take-off: mind the cables there.
Before every flight: hitchopt lint on this folder.
"""


def note_text(task: Task, duration: float) -> str:
    """Return README.txt."""
    placeholders = (
        ""
        if task.fleet.given
        else (" (its radio addresses are placeholders: name yours with --fleet when exporting)")
    )
    return NOTE.format(
        title=task.title or "A plan of hitchopt",
        frame=task.room.frame,
        duration=duration,
        placeholders=placeholders,
    )
