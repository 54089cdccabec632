"""How two cables touch at a clasp: length of the contact, and the angle between the cables there.

Usage: python -m benchmarks.clasp_contacts [TURN_DEG …] [--density KG/M] [--segment METRES]

Triangles at rest, without friction, one vertex of which has an interior angle of TURN_DEG, by which
both its cables turn. Printed are the normal forces over the tension, which is the angle by which a
cable turns in space, over its turn in the plane; and the mean cosine between the cables' directions
toward their legs where they touch. ``hitchopt/calibration/clasp_sliding.py`` holds both.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.environment import print_environment
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.simulation.cable_shapes import clasped
from hitchopt.simulation.drone_control import POSITION_GAIN, VELOCITY_GAIN
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.ropes import ropes_of
from hitchopt.simulation.simulation_settings import ACCURATE, DENSITY, Preset, Settings
from hitchopt.simulation.validity import check_valid, tensions
from hitchopt.values import Array

LIMITATIONS = "ropes of 12 mm in segments, no bending stiffness, no friction; triangles at rest"

EDGE, LEGS, TENSION = 1.3, 1.0, 0.5
"""Equal edges of the triangles, length of both legs of a cable [m], and tension [N]."""

DRAWN, SETTLED, MEASURED = 1.5, 1.0, 0.2
"""Times in which cables are drawn tight, come to rest, and are measured [s]."""

DAMPING = 40.0
"""Rate at which cables lose speed [1/s]."""


@dataclass(frozen=True)
class ClaspContact:
    """Contact of two cables.

    Attributes
    ----------
    turn: mean angle by which the cables turn between chords [rad].
    wrap: angle by which they turn in space [rad].
    cosine: mean cosine between the cables' directions, weighed by normal forces.
    spread: standard deviation of the cosine over the contact.
    """

    turn: float
    wrap: float
    cosine: float
    spread: float


def clasp_contact(turn: float, density: float, preset: Preset) -> ClaspContact:
    """Return the contact at the first vertex of a triangle, whose interior angle is ``turn``."""
    half = EDGE * np.array([np.sin(0.5 * turn), -np.cos(0.5 * turn)])
    points = np.array([[0.0, 0.0], half, half * [-1.0, 1.0]])
    lengths = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=-1) + LEGS
    team = Team(3, lengths, tension=TENSION, cable_density=density)
    hitch = Hitch.balanced(team, points, 1.6)
    ropes = ropes_of(team, Settings(preset=preset))
    world = World(ropes, team.mass, rigid=False)
    world.place(clasped(ropes, team.layout, hitch.drones, hitch.vertices))
    loose = world.drones - hitch.drones
    slowing = DAMPING * density * float(ropes.segment_lengths[0])
    found = []
    for step in range(round((DRAWN + SETTLED + MEASURED) / preset.time_step)):
        time = step * preset.time_step
        drawn = min(1.0, time / DRAWN)
        share = drawn**3 * (10.0 - 15.0 * drawn + 6.0 * drawn**2)
        error = hitch.drones + (1.0 - share) * loose - world.drones
        rate = world.data.qvel[world.drone_dofs]
        force = team.mass[:, None] * (POSITION_GAIN * error - VELOCITY_GAIN * rate)
        force[:, 2] += GRAVITY * team.mass
        world.data.xfrc_applied[world.drone_bodies, :3] = force - share * hitch.cable_forces
        world.data.qfrc_applied[world.node_dofs] = -slowing * world.data.qvel[world.node_dofs]
        world.step(loose=share < 1.0)
        check_valid(world, time)
        if time >= DRAWN + SETTLED:
            found.append(_contacts(world))
    forces, cosines = np.concatenate([row[:2] for row in found], axis=1)
    place = found[-1][2:] @ found[-1][0] / np.sum(found[-1][0])
    mean = float(np.sum(forces * cosines) / np.sum(forces))
    spread = float(np.sqrt(np.sum(forces * (cosines - mean) ** 2) / np.sum(forces)))
    legs = unit(world.drones[[0, 5]] - place)
    edges = unit(hitch.vertices[[1, 2]] - hitch.vertices[0])
    turned = float(np.mean(np.arccos(-np.sum(legs * edges, axis=-1))))
    return ClaspContact(turned, float(np.sum(forces)) / len(found), mean, spread)


def _contacts(world: World) -> Array:
    """Return (5, contacts) at the first vertex.

    These are normal forces over the tension, cosines between the cables, and places [m].
    """
    data, nodes = world.data, world.nodes
    rows, flexes = data.contact.efc_address, data.contact.flex
    chosen = np.flatnonzero(np.all(np.sort(flexes, axis=1) == [0, 2], axis=1) & (rows >= 0))
    first = world.cable_vertices[flexes[chosen]] + data.contact.elem[chosen]
    along = unit(nodes[first + 1] - nodes[first])
    cosines = -np.sum(along[:, 0] * along[:, 1], axis=-1)  # toward q of one, r of the other
    forces = data.efc_force[rows[chosen]] / np.mean(tensions(world))
    return np.vstack([forces, cosines, data.contact.pos[chosen].T])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for every turn."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("turns", type=float, nargs="*", default=[30, 45, 60, 75, 90, 120])
    parser.add_argument("--density", type=float, default=DENSITY)
    parser.add_argument("--segment", type=float, default=ACCURATE.segment)
    given = parser.parse_args(arguments)
    step = ACCURATE.time_step * given.segment / ACCURATE.segment
    preset = Preset("clasp", given.segment, ACCURATE.diameter, step)
    print_environment(LIMITATIONS)
    print("\n| turn [deg] | in space over turn | cosine | its spread |\n|---|---|---|---|")
    for turn in np.radians(given.turns):
        found = clasp_contact(float(turn), given.density, preset)
        ratio, turned = found.wrap / found.turn, np.degrees(found.turn)
        cells = f"{turned:.1f} | {ratio:.3f} | {found.cosine:.3f} | {found.spread:.3f}"
        print(f"| {cells} |", flush=True)


if __name__ == "__main__":
    main()
