"""Tensions on both sides of a clasp whose cables slide at given rates, against the law.

Usage: python -m benchmarks.clasp_ratios [TURN_DEG …] [--friction MU …] [--speed M/S]

One clasp without gravity; four springs draw its cables through it, and share out the tension as the
law has it, such that the clasp stays where it is. Printed are the rates at which cables slide
toward their legs, what the law of ``hitchopt/calibration/clasp_sliding.py`` makes of them, both
over friction and turn, and the simulated ratios over the law's, by least squares.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from benchmarks.clasp_contacts import DAMPING
from benchmarks.environment import print_environment
from hitchopt.calibration.clasp_sliding import friction_pulls
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.cable_shapes import clasped
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.ropes import ropes_of
from hitchopt.simulation.simulation_settings import ACCURATE, DENSITY, Settings
from hitchopt.simulation.validity import check_valid, tensions
from hitchopt.values import Array

LIMITATIONS = "ropes of 12 mm in segments of 10 mm; no gravity; one clasp in one plane"

EDGE, LEG, TENSION = 0.8, 0.7, 0.5
"""Length of both cables before and after the clasp [m], and tension [N]."""

STIFFNESS, DAMPING_RATIO = 5.0, 0.8
"""Of the springs that hold the ends [N/m]."""

DRAWN, LEANT, SLID, MEASURED = 1.0, 0.8, 0.6, 1.4
"""Times in which cables are drawn tight, lean as friction has it, slide, and are measured [s]."""

EVERY = 5
"""Steps between two rows of what is measured."""

RATES = ((1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
"""Rates toward the legs, of the cable ahead and the one behind, over the speed."""

PHASES = (0.0, 0.005)
"""Differences of the cables' lengths [m]: segments meet in another phase."""


@dataclass(frozen=True)
class Sliding:
    """A clasp whose cables slide; pairs are those of the cable ahead and the one behind.

    Attributes
    ----------
    turn: mean angle in the plane by which cables turn [rad].
    rates: (2,) [m/s], toward the legs.
    ratios: (2,), logarithms of leg over edge tensions.
    pulls: (2,), the same by the law at a friction of 1.
    """

    turn: float
    rates: Array
    ratios: Array
    pulls: Array


def sliding(turn: float, friction: float, rates: Array, phase: float = 0.0) -> Sliding:
    """Return what was measured at a clasp.

    Parameters
    ----------
    turn: angle by which cables turn [rad].
    friction: coefficient.
    rates: (2,) [m/s], at which the ends of the cable ahead and the one behind are drawn.
    phase: by which one cable is longer [m].
    """
    lengths = EDGE + LEG + np.array([0.0, phase])
    team = Team(2, lengths, topology="open", cable_density=DENSITY, cable_friction=friction)
    half = EDGE * np.array([np.sin(0.5 * turn), np.cos(0.5 * turn)])
    hitch = Hitch(
        team, half * np.array([[-1.0, -1.0], [0.0, 0.0], [1.0, -1.0]]), 1.0, [0.0, LEG + phase]
    )
    ropes = ropes_of(team, Settings(preset=ACCURATE))
    world = World(ropes, team.mass, rigid=False, gravity=0.0)
    world.place(clasped(ropes, team.layout, hitch.drones, hitch.vertices))
    start, clasp = world.drones, hitch.vertices[1]
    law = friction * friction_pulls(np.full(2, turn), rates)
    pull, out = _leaning(turn, float(np.exp(0.5 * np.sum(law))))
    far = np.linalg.norm(hitch.drones - clasp, axis=-1, keepdims=True)
    drawn_at = np.outer([-rates[1], rates[1], rates[0], -rates[0]], np.ones(3)) * out
    damping = 2.0 * DAMPING_RATIO * np.sqrt(STIFFNESS * team.mass[:, None])
    rough, rows = world.model.flex_friction.copy(), []
    begin = DRAWN + LEANT + SLID
    for step in range(round((begin + MEASURED) / ACCURATE.time_step)):
        time = step * ACCURATE.time_step
        tight, leant = _smooth(time / DRAWN), _smooth((time - DRAWN) / LEANT)
        world.model.flex_friction[:] = rough * (time >= DRAWN)
        slid = max(time - DRAWN - LEANT, 0.0)
        straight = clasp + far * unit((1.0 - leant) * unit(hitch.drones - clasp) + leant * out)
        goal = straight + (1.0 - tight) * (start - hitch.drones) + slid * drawn_at
        error, speed = goal - world.drones, world.data.qvel[world.drone_dofs]
        force = STIFFNESS * error + damping * (drawn_at * (slid > 0.0) - speed)
        force += TENSION * tight * (1.0 + leant * (pull - 1.0)) * unit(world.drones - clasp)
        world.data.xfrc_applied[world.drone_bodies, :3] = force
        slowing = DAMPING * (1.0 - tight) * DENSITY * float(ropes.segment_lengths[0])
        world.data.qfrc_applied[world.node_dofs] = -slowing * world.data.qvel[world.node_dofs]
        world.step(loose=tight < 1.0)
        check_valid(world, time)
        if time >= begin and step % EVERY == 0:
            rows.append(_row(world))
    found = np.array(rows)
    place, ends = found[:, :3], found[:, 3:15].reshape(-1, 4, 3)
    legs = np.linalg.norm(ends[:, [2, 1]] - place[:, None], axis=-1)
    measured = np.polyfit(EVERY * ACCURATE.time_step * np.arange(len(legs)), legs, 1)[0]
    toward = unit(np.mean(ends, axis=0) - np.mean(place, axis=0))
    turns = np.arccos(-np.array([toward[2] @ toward[3], toward[1] @ toward[0]]))
    parts = np.mean(found[:, 15:], axis=0)  # leg and edge, of the cable ahead, then behind
    ratios = np.log(parts[[0, 2]] / parts[[1, 3]])
    return Sliding(float(np.mean(turns)), measured, ratios, friction_pulls(turns, measured))


def _smooth(share: float) -> float:
    """Return a step from 0 to 1 without a jerk at its ends."""
    share = min(max(share, 0.0), 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def _leaning(turn: float, ratio: float) -> tuple[Array, Array]:
    """Return pulls (4, 1) over the mean and directions (4, 3) of q0, r0, q1, r1 in balance.

    Legs pull ``ratio`` times as hard as edges, and turn outward until both cancel.
    """
    edge = float(brentq(lambda x: np.cos(x) - ratio * np.cos(turn - x), 0.0, turn))
    leg = turn - edge
    x, y = [-np.sin(edge), -np.sin(leg), np.sin(leg), np.sin(edge)], np.cos([edge, leg, leg, edge])
    directions = np.stack([x, y * [-1.0, 1.0, 1.0, -1.0], np.zeros(4)], axis=-1)
    pulls: Array = np.sqrt(ratio) ** np.array([[-1.0], [1.0], [1.0], [-1.0]])
    return pulls, directions


def _row(world: World) -> Array:
    """Return the centre of the contact, the ends, and the tensions of leg, edge, leg, edge."""
    data, pulls = world.data, tensions(world)
    flexes, rows = data.contact.flex, data.contact.efc_address
    chosen = np.flatnonzero(np.all(flexes >= 0, axis=1) & (rows >= 0))
    forces = data.efc_force[rows[chosen]]
    place = forces @ data.contact.pos[chosen] / np.sum(forces)
    behind, ahead = np.split(pulls, [int(world.ropes.segments[0])])
    sides: list[float] = []
    for cable in (ahead, behind[::-1]):  # from the leg's end on
        twentieth = len(cable) // 20
        parts = cable[twentieth : 6 * twentieth], cable[14 * twentieth : -twentieth]
        sides.extend(float(np.mean(part)) for part in parts)
    return np.concatenate([place, world.drones.ravel(), sides])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for every turn, friction and pair of rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("turns", type=float, nargs="*", default=[45, 60, 75])
    parser.add_argument("--friction", type=float, nargs="+", default=[0.1, 0.3])
    parser.add_argument("--speed", type=float, default=0.05)
    given = parser.parse_args(arguments)
    print_environment(LIMITATIONS)
    print("\n| turn [deg] | μ | rates [mm/s] | simulated | law | simulated over law |")
    print("|---|---|---|---|---|---|")
    for degrees in given.turns:
        for friction in given.friction:
            for rates in RATES:
                drawn = given.speed * np.array(rates)
                found = [sliding(np.radians(degrees), friction, drawn, p) for p in PHASES]
                turn = np.mean([one.turn for one in found])
                rate = 1e3 * np.mean([one.rates for one in found], axis=0)
                ratios = np.mean([one.ratios for one in found], axis=0) / friction
                pulls = np.mean([one.pulls for one in found], axis=0)
                pairs = " | ".join(f"{a:+.2f}, {b:+.2f}" for a, b in (ratios / turn, pulls / turn))
                share = ratios @ pulls / (pulls @ pulls)
                cells = f"{np.degrees(turn):.1f} | {friction:g} | {rate[0]:+.0f}, {rate[1]:+.0f}"
                print(f"| {cells} | {pairs} | {share:.2f} |", flush=True)


if __name__ == "__main__":
    main()
