"""An independent quadrotor simulator (rotorpy) tracks exported polynomials.

Usage: python -m benchmarks.tracking [--output FILE]

The CSV of each problem's fastest drones, read by numpy alone, is flown by rotorpy's Hummingbird and
geometric controller, and so is the plan that it was exported from. If the export costs anything in
flight, the two differ.
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

import hitchopt as ho
from benchmarks.environment import environment

Array = NDArray[np.float64]
Curve = Callable[[float, int], Array]
"""Position (3,) [m], or a derivative by time, at a time."""

PROBLEMS = Path(__file__).parents[1] / "problems"

STEMS = ("triangle", "move_vertex", "square_half_turn", "transport")

FASTEST = 3
"""Drones of a problem that are flown."""

STEP = 0.005
"""[s] Of the simulation and of the controller."""

SETTLED = 1.0
"""[s] Flown on at the last point."""

LIMITATIONS = (
    "one drone after the other, without cables (rotorpy knows none), without noise or wind; "
    "rotorpy's Hummingbird of 0.5 kg and its geometric controller with default gains; one run "
    "each, which is exact to repeat"
)


@dataclass(frozen=True)
class Flown:
    """How far a drone was from its reference.

    Attributes
    ----------
    rms, worst: [m]
    """

    rms: float
    worst: float


def exported_curve(path: Path) -> Curve:
    """Return what a polynomial CSV says, at rest after its end."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)
    ends = np.cumsum(rows[:, 0])

    def curve(t: float, order: int) -> Array:
        if t >= ends[-1] and order > 0:
            return np.zeros(3)
        at = min(t, float(ends[-1]))
        i = min(int(np.searchsorted(ends, at, side="right")), len(rows) - 1)
        tau = at - (ends[i] - rows[i, 0])
        axes = [np.polynomial.Polynomial(rows[i, 1 + 8 * a : 9 + 8 * a]) for a in range(3)]
        return np.array([axis.deriv(order)(tau) if order else axis(tau) for axis in axes])

    return curve


def planned_curve(motion: ho.Motion, drone: int) -> Curve:
    """Return what the plan says of a drone, at rest after its end."""
    one = ho.PiecewisePolynomial(motion.drones.breaks, motion.drones.coefficients[:, drone])

    def curve(t: float, order: int) -> Array:
        if t >= motion.duration and order > 0:
            return np.zeros(3)
        return np.asarray(one.at(min(t, motion.duration), order))

    return curve


def fly(curve: Curve, duration: float) -> Flown:
    """Return how rotorpy's Hummingbird follows a curve, starting at rest on it."""
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
    errors = []
    for k in range(int((duration + SETTLED) / STEP) + 1):
        t = k * STEP
        names = ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot")
        reference = {name: curve(t, order) for order, name in enumerate(names)}
        errors.append(float(np.linalg.norm(state["x"] - reference["x"])))
        flat = {**reference, "yaw": 0.0, "yaw_dot": 0.0, "yaw_ddot": 0.0}
        state = vehicle.step(state, controller.update(t, state, flat), STEP)
    return Flown(float(np.sqrt(np.mean(np.square(errors)))), max(errors))


def measure(stem: str) -> str:
    """Return the row of one problem: the worst of its drones, as exported and as planned."""
    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    with tempfile.TemporaryDirectory() as place:
        (part,) = plan.export("crazyswarm2", place)
        names = plan.motion.team.drone_names
        t = np.linspace(0.0, plan.duration, 500)
        speeds = np.max(np.linalg.norm(plan.motion.drones.at(t, 1), axis=-1), axis=0)
        drones = np.argsort(-speeds)[:FASTEST].tolist()
        files = [exported_curve(Path(place) / f"{names[i]}.csv") for i in drones]
    exported = [fly(curve, plan.duration) for curve in files]
    planned = [fly(planned_curve(plan.motion, i), plan.duration) for i in drones]
    apart = max(abs(a.worst - b.worst) for a, b in zip(exported, planned, strict=True))
    cells = [
        stem,
        str(len(drones)),
        f"{plan.duration:.2f}",
        f"{plan.motion.drones.pieces}",
        f"{1e3 * part.verdict.position.worst:.2g}",
        f"{1e3 * max(f.rms for f in exported):.3f}",
        f"{1e3 * max(f.worst for f in exported):.3f}",
        f"{1e3 * max(f.worst for f in planned):.3f}",
        f"{1e3 * apart:.2g}",
    ]
    return f"| {' | '.join(cells)} |"


COLUMNS = (
    "problem",
    "drones",
    "plan [s]",
    "its pieces",
    "export off by [mm]",
    "rms of file [mm]",
    "worst of file [mm]",
    "worst of plan [mm]",
    "file less plan [mm]",
)


def main() -> None:
    """Print and write machine, versions, limitations and a row for every problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parent / "results" / "tracking.md"
    parser.add_argument("--output", type=Path, default=default)
    output = parser.parse_args().output
    lines = [
        f"# Tracking of exported polynomials, {datetime.date.today()}",
        "",
        "`python -m benchmarks.tracking`",
        "",
        f"- {environment(('rotorpy',))}",
        f"- limitations: {LIMITATIONS}",
        f"- the {FASTEST} fastest drones of each, the worst of them; errors are distances between "
        f"drone and reference, over the plan and {SETTLED:g} s after it",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"| {' | '.join(['---'] * len(COLUMNS))} |",
    ]
    print("\n".join(lines), flush=True)
    for stem in STEMS:
        lines.append(measure(stem))
        print(lines[-1], flush=True)
    output.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
