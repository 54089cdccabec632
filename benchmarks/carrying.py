"""Objects carried by simulated ropes: whole missions, and loads held and lost.

Usage: python -m benchmarks carrying [CASE ...] [--runs N] [--seed S] [--preset NAME]
                                     [--processes P] [--loads]

A hitch is tied from the ground, takes an object that stands 2.2 m away, carries it by 1.5 m, sets
it down and leaves; it is untied and lands. Trays of 200 g stand on a foot and are taken by their
rims, 25 cm above the ground; that of six robots, whose longer legs reach down, at 40 cm. Drums of
100 g and boxes of 60 g are gripped with 1.3 N. With ``--loads`` the object is instead lifted by
10 cm and held for 10 s at 0.8 of the largest mass that can be planned.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.flights import centimetres, fly, success
from benchmarks.measuring import Table, parser

LIMITATIONS = (
    "simulated ropes of 12 mm; one size and mass of each object; succeeded: placed within 3 cm and "
    "5°, no drone touched anything, no cable touched an object that it did not hold, all free at "
    "the end; perturbed as in flights.md, and mass ±10 %, friction ±20 %, objects up to 2 cm off "
    "(loads held: mass and friction exact)"
)

CABLES = {"tray-3": 2.2, "tray-4": 1.8, "tray-6": 1.8, "drum-3": 1.6, "box-4": 1.3}
"""Cable lengths by case [m]; the number of robots ends the case's name."""

BODIES: dict[str, dict[str, Any]] = {
    "tray": {"circle": 0.08, "to": 0.3, "mass": 0.2, "rim": {"circle": 0.3, "at": 0.25}},
    "tray-6": {"circle": 0.08, "to": 0.45, "mass": 0.2, "rim": {"circle": 0.3, "at": 0.4}},
    "drum": {"circle": 0.2, "mass": 0.1, "friction": 0.5},
    "box": {
        "outline": [[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [-0.2, 0.15]],
        "mass": 0.06,
        "friction": 0.8,
    },
}

RADIUS = {"tray": 0.4, "drum": 0.56, "box": 0.46}
"""Radius of the hitch after forming [m]; a gripping hitch is as large as around the object."""

AWAY, BY, ALTITUDE, STARTS = 2.2, 1.5, 1.3, 1.0
"""Place of the object in x, distance of its transport in y, altitude of the formed hitch, and
distance of the starting rows from the hitch's centre [m]."""


def setting(case: str) -> tuple[int, str, dict[str, Any], list[list[float]], dict[str, Any]]:
    """Return robots, kind, team, polygon [m] and body of a case."""
    kind, number = case.split("-")
    n = int(number)
    angles = -2.0 * np.pi * np.arange(n) / n
    polygon = RADIUS[kind] * np.column_stack([np.cos(angles), np.sin(angles)])
    team = {"robots": n, "cable_length": CABLES[case], "cable_density": 0.01, "tension": 1.0}
    if kind != "tray":
        team["cable_friction"] = 0.15
    return n, kind, team, polygon.tolist(), dict(BODIES.get(case, BODIES[kind]))


def mission(case: str) -> dict[str, Any]:
    """Return the problem of a whole mission."""
    n, kind, team, polygon, body = setting(case)
    corners = np.array(polygon)
    onward = np.roll(corners, -1, axis=0)
    along = (onward - corners) / np.linalg.norm(onward - corners, axis=1, keepdims=True)
    outward = (onward + corners) / np.linalg.norm(onward + corners, axis=1, keepdims=True)
    half = 0.375 * min(CABLES[case], 2.0 * STARTS * np.tan(np.pi / n))
    q, r = (np.pad(STARTS * outward + s * half * along, ((0, 0), (0, 1))) for s in (-1.0, 1.0))
    carry: dict[str, Any] = {"object": "carried", "to": [AWAY, BY, 0.0]}
    if kind != "tray":
        carry["tension"] = 1.3
    return {
        "team": team,
        "limits": {"tilt_deg": 60},
        "objects": {"carried": {**body, "at": [AWAY, 0.0, 0.0]}},
        "start": {"drones": {"q": q.tolist(), "r": r.tolist()}},
        "mission": [
            {"form": {"polygon": polygon, "altitude": ALTITUDE}},
            {"transport_object": carry},
            {"transport": {"to": [0.0, BY, ALTITUDE]}},
            {"release": {}},
            {"land": {}},
        ],
    }


def load(case: str, mass: float) -> dict[str, Any]:
    """Return the problem of a hitch that encloses and holds an object of a mass [kg]."""
    _, kind, team, polygon, body = setting(case)
    grasp: dict[str, Any] = {"object": "held"}
    if kind != "tray":
        grasp |= {"by": "grip", "tension": 1.3}
    return {
        "team": team,
        "limits": {"tilt_deg": 60},
        "objects": {"held": {**body, "mass": mass, "at": [0.0, 0.0, 0.0]}},
        "start": {"hitch": {"polygon": polygon, "altitude": 0.8}},
        "mission": [
            {"enclose": {"object": "held"}},
            {"grasp": grasp},
            {"lift": {"by": 0.1}},
            {"hold": {"seconds": 10.0}},
        ],
    }


def largest_mass(case: str) -> float:
    """Return the largest mass [kg] with a plan, to one per cent."""
    low, high = 0.02, 1.0
    while high > 1.01 * low:
        middle = float(np.sqrt(low * high))
        try:
            ho.solve(ho.problem_from_dict(load(case, middle)))
            low = middle
        except ho.InfeasibleError:
            high = middle
    return low


def main() -> None:
    """Print and write a row for each case."""
    cli = parser(__doc__, runs=10, seed=7000, preset="accurate", processes=1)
    cli.add_argument("cases", nargs="*", help=f"{', '.join(CABLES)}; by default all")
    cli.add_argument("--loads", action="store_true", help="hold 0.8 of the largest mass")
    options = cli.parse_args()
    name = "carrying_loads" if options.loads else "carrying"
    title = "Loads held" if options.loads else "Objects carried from the ground and back"
    table = Table(options.output / f"{name}.md", title, LIMITATIONS, ("mujoco",))
    table.note(f"preset {options.preset}, seeds from {options.seed} on")
    columns = ("flights", "succeeded (95 %)", "first failures", "placed [cm]", "slipped [cm]")
    table.section("", "case", "mass [g]", *columns)
    exact: dict[str, Any] = {"perturbations": {"object_mass": 0.0, "object_friction": 0.0}}
    for case in options.cases or CABLES:
        mass = 0.8 * largest_mass(case) if options.loads else float(setting(case)[4]["mass"])
        problem = load(case, mass) if options.loads else mission(case)
        try:
            plan = ho.solve(ho.problem_from_dict(problem))
        except ho.InfeasibleError as error:
            table.row(case, 1e3 * mass, 0, f"refused: {error.violations[0].constraint}", "", "", "")
            continue
        settings = {"pull_test": False, **(exact if options.loads else {})}
        runs = fly(plan, options.runs, options.seed, options.preset, options.processes, **settings)
        errors = (
            centimetres([run.figures.get(name, np.nan) for run in runs])
            for name in ("placed", "slipped")
        )
        table.row(case, 1e3 * mass, *success(runs), *errors)
