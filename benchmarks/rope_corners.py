"""What a simulated rope presses with on the corner that it bends about, and what slips there.

Usage: python -m benchmarks.rope_corners

A rope of 0.5 m is bent by 34° about a disc, or a corner of a box of 0.4 m × 0.3 m, sharp or round,
and pulled by 1.3 N at both ends, without weight, until it rests. Of a cable the sum of all contact
forces is `T θ`, whatever it is bent about. Then both pulls rise, until it slides up: a cable does
where friction takes `μ T θ`. Nodes begin at several places along the bend.

Two nodes that touch a corner r from the centre of its rounding, on either side of its bisector,
press there at angles of `φ = asin(s / 2r)` to it, s their distance, 45° at most, on the faces of a
right angle. Their forces add up to `2 T sin(θ/2) / cos φ`.
"""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks.carrying import SIDES
from hitchopt.objects import Section, SolidObject
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.ropes import Ropes
from hitchopt.simulation.simulation_settings import Preset
from hitchopt.values import Array

TENSION, BEND, LENGTH, THICK = 1.3, np.radians(34.0), 0.5, 0.012
"""Pull [N], angle [rad], length and diameter of the rope [m]."""

HEIGHT, SETTLED, MASS = 0.15, 1.0, 0.05
"""Height of the rope [m], time after which forces are averaged [s], and mass of an end [kg]."""

END_DAMPING, LESS, NODE_DAMPING = 2.0, 0.3, 2.0
"""[N s/m] of each end until it rests, and as pulls rise, and [N s/m²] of the rope."""

FRICTION, STEEPEST, RISING, SLIDES = 0.3, 2.2, 1.2, 0.002
"""Coefficient on the box, largest slope of pulls over that at which a cable slides, time in which
it is reached [s], and how far up the rope has slid where friction is averaged [m]."""

POINTS = 13
"""Points of the outline at the round corner."""

PLACES = (0.0, 0.25, 0.5)
"""Where the middle of the bend is between two nodes, in segments."""

SEGMENTS = (0.010, 0.005, 0.0025)
"""Lengths of segments [m]."""

CASES: tuple[tuple[str | float, float], ...] = (
    ("disc of 0.2 m", 0.010),
    *((radius, segment) for radius in (0.0, 0.005, 0.01, 0.02, 0.05) for segment in SEGMENTS),
)
"""What the rope is bent about, radii of corners among them [m], and lengths of segments [m]."""


def bent_about(shape: str | float) -> tuple[Section, Array, float]:
    """Return a section, and the centre (2,) [m] and radius [m] of the bend about it."""
    if shape == "disc of 0.2 m":
        return Section(radius=0.2), np.zeros(2), 0.2
    radius = float(shape)
    centre = np.array(SIDES[2]) - radius
    if radius == 0.0:
        return Section(SIDES), centre, 0.0
    angles = np.linspace(0.0, 0.5 * np.pi, POINTS)
    arc = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return Section([*SIDES[:2], *arc.tolist(), SIDES[3]]), centre, radius


def pressed(shape: str | float, segment: float, place: float) -> tuple[float, float]:
    """Return the sum of contact forces over tension times bend, and the same of friction.

    Parameters
    ----------
    segment: length of the rope's segments [m].
    place: where the middle of the bend is, in segments from a node.

    Returns
    -------
    Both ratios; that of friction, over the coefficient, is nan where the rope does not slide.
    """
    section, centre, radius = bent_about(shape)
    body = SolidObject(section, 0.0, 0.3, mass=0.06, friction=FRICTION, fixed=True)
    preset = Preset("corner", segment, THICK, 0.04 * segment)
    ropes = Ropes(np.array([LENGTH]), 0.01, 0.15, preset)
    masses = np.full(2, MASS)
    world = World(ropes, masses, rigid=False, ground=-1.0, gravity=0.0, objects={"box": body})
    nodes = np.linspace(0.0, LENGTH, int(ropes.segments[0]) + 1)
    along = nodes - 0.5 * LENGTH - place * segment
    turned = np.clip(along / (radius + 0.5 * THICK), -0.5 * BEND, 0.5 * BEND)
    angle = 0.25 * np.pi - turned
    outward = np.column_stack([np.cos(angle), np.sin(angle)])
    onward = np.column_stack([np.sin(angle), -np.cos(angle)])
    rest = along - turned * (radius + 0.5 * THICK)
    rope = centre + (radius + 0.5 * THICK) * outward + rest[:, None] * onward
    world.place([np.column_stack([rope, np.full(len(rope), HEIGHT)])])
    level = TENSION * np.pad(np.stack([-onward[0], onward[-1]]), ((0, 0), (0, 1)))
    force, found, slid = np.zeros(6), [], []
    data, bend = world.data, 0.5 * FRICTION * BEND  # as steep as a cable that slides
    for step in range(round((SETTLED + RISING) / preset.time_step)):
        rising = max(step * preset.time_step - SETTLED, 0.0) / RISING
        slope = STEEPEST * bend * rising
        pulls = np.cos(slope) * level + [0.0, 0.0, TENSION * np.sin(slope)]
        damping = LESS if rising else END_DAMPING
        data.qfrc_applied[world.drone_dofs] = pulls - damping * data.qvel[world.drone_dofs]
        node_damping = NODE_DAMPING * segment
        data.qfrc_applied[world.node_dofs] = -node_damping * data.qvel[world.node_dofs]
        world.step()
        if step * preset.time_step > 0.7 * SETTLED and step % 20 == 0:
            total = np.zeros(2)
            for contact in range(data.ncon):
                mujoco.mj_contactForce(world.model, data, contact, force)
                upright = data.contact[contact].frame.reshape(3, 3)[:, 2] @ force[:3]
                total += [force[0], abs(upright) / FRICTION]
            if not rising:
                found.append(total[0])
            elif world.nodes[len(nodes) // 2, 2] > HEIGHT + SLIDES:
                slid.append(total[1])
    unit = TENSION * float(BEND)
    return float(np.mean(found)) / unit, float(np.mean(slid)) / unit if slid else float("nan")


def main() -> int:
    """Print all cases; return 0."""
    for shape, segment in CASES:
        ratios = [pressed(shape, segment, place) for place in PLACES]
        corner = shape if isinstance(shape, str) else f"radius of {1e3 * shape:.0f} mm"
        texts = (", ".join(f"{ratio:.3f}" for ratio in each) for each in zip(*ratios, strict=True))
        words = "; slides at ".join(texts)
        print(f"{corner}, segments of {1e3 * segment:.1f} mm: {words}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
