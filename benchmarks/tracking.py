"""Exports flown elsewhere: an independent simulator (rotorpy) tracks exported polynomials.

Usage: python -m benchmarks tracking

The CSV of each problem's fastest drones, read by numpy alone, is flown by rotorpy's Hummingbird and
geometric controller, and so is the plan that it was exported from. If the export costs anything in
flight, the two differ.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

import hitchopt as ho
from benchmarks.measuring import PROBLEMS, Array, Table, parser
from hitchopt.trajectory import PiecewisePolynomial

Curve = Callable[[float, int], Array]
"""Position (3,) [m], or a time derivative, at a time."""

STEMS, FASTEST = ("triangle", "move_vertex", "square_half_turn", "transport"), 3

STEP, SETTLED = 0.005, 1.0
"""Time step of simulation and controller, and time of flight at the last point [s]."""

LIMITATIONS = (
    "one drone after the other, without cables (rotorpy has none), noise or wind; rotorpy's "
    f"Hummingbird of 0.5 kg, default gains; the worst of each problem's {FASTEST} fastest drones"
)


def exported_curve(path: Path) -> Curve:
    """Return the curve of a polynomial CSV, at rest after its end."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)
    ends = np.cumsum(rows[:, 0])

    def curve(t: float, order: int) -> Array:
        if t >= ends[-1] and order > 0:
            return np.zeros(3)
        at = min(t, float(ends[-1]))
        i = min(int(np.searchsorted(ends, at, side="right")), len(rows) - 1)
        local = at - (ends[i] - rows[i, 0])
        axes = [np.polynomial.Polynomial(rows[i, 1 + 8 * a : 9 + 8 * a]) for a in range(3)]
        return np.array([axis.deriv(order)(local) if order else axis(local) for axis in axes])

    return curve


def planned_curve(motion: ho.Motion, drone: int) -> Curve:
    """Return the curve of a drone in the plan, at rest after its end."""
    one = PiecewisePolynomial(motion.drones.breaks, motion.drones.coefficients[:, drone])

    def curve(t: float, order: int) -> Array:
        if t >= motion.duration and order > 0:
            return np.zeros(3)
        return np.asarray(one.at(min(t, motion.duration), order))

    return curve


def fly(curve: Curve, duration: float) -> float:
    """Return the maximum tracking error of rotorpy's Hummingbird, initially at rest [m]."""
    hover = float(np.sqrt(quad_params["mass"] * 9.81 / 4 / quad_params["k_eta"]))
    state = {
        "x": curve(0.0, 0),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, hover),
    }
    vehicle, controller = Multirotor(quad_params, state), SE3Control(quad_params)
    names, worst = ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot"), 0.0
    for k in range(int((duration + SETTLED) / STEP) + 1):
        reference = {name: curve(k * STEP, order) for order, name in enumerate(names)}
        worst = max(worst, float(np.linalg.norm(state["x"] - reference["x"])))
        flat = {**reference, "yaw": 0.0, "yaw_dot": 0.0, "yaw_ddot": 0.0}
        state = vehicle.step(state, controller.update(k * STEP, state, flat), STEP)
    return worst


def measure(stem: str) -> tuple[object, ...]:
    """Return the row of one problem."""
    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    speeds = np.max(
        np.linalg.norm(plan.motion.drones.at(np.linspace(0.0, plan.duration, 500), 1), axis=-1),
        axis=0,
    )
    drones = np.argsort(-speeds)[:FASTEST].tolist()
    with tempfile.TemporaryDirectory() as place:
        (part,) = plan.export("crazyswarm2", place, allow_slack=True)
        names = plan.motion.team.drone_names
        files = [exported_curve(Path(place) / f"{names[i]}.csv") for i in drones]
    exported = [1e3 * fly(curve, plan.duration) for curve in files]
    planned = [1e3 * fly(planned_curve(plan.motion, i), plan.duration) for i in drones]
    difference = max(abs(a - b) for a, b in zip(exported, planned, strict=True))
    export = 1e3 * part.verdict.position.worst
    return stem, plan.duration, export, max(exported), max(planned), difference


def main() -> None:
    """Print and write a row for every problem."""
    options = parser(__doc__).parse_args()
    table = Table(
        options.output / "tracking.md", "Exports flown elsewhere", LIMITATIONS, ("rotorpy",)
    )
    columns = ("export off by [mm]", "file missed by [mm]", "plan missed by [mm]", "apart [mm]")
    table.section("", "problem", "plan [s]", *columns)
    for stem in STEMS:
        table.row(*measure(stem))
