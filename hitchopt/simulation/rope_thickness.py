"""Correction for simulated ropes that are thicker than real cables.

It concerns the simulation alone, not the flight. Where a cable goes around another, its centre line
keeps one diameter from the other's, whose far side is half a diameter from the vertex: the bend
takes length. Segments that are longer than the bend is wide use up more. Without it ropes would be
too short, and pull harder than planned.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import unit
from hitchopt.simulation.flight_task import Task
from hitchopt.values import Array

COARSENESS = 0.15
"""Length that coarse segments use up in a bend of 180°, over the square of a segment's length over
the diameter: within 1 mm at a clasp for regular hitches of n = 3, 6, 12 with segments of 30 mm, and
n = 3, 6 with 10 mm (12 mm thick, 10 g/m at 0.5 N)."""

LEVEL = np.array([1.0, 1.0, 0.0])
"""Factor that leaves the level part of vectors."""


def thickness_allowance(task: Task, diameter: float, segment: float) -> Array:
    """Return (n,) [m]: the additional length with which thick cables take their bends.

    It is what ``bend_lengths`` says of both clasps of a cable and, of one that is wrapped around an
    object, half a diameter times the angle by which it turns there, seen from above.

    Parameters
    ----------
    task: the plan.
    diameter: of the simulated cables [m].
    segment: length of their segments [m].
    """
    layout = task.team.layout
    allowance = np.zeros(task.team.robots)
    longer = bend_lengths(task, diameter, segment)
    np.add.at(allowance, layout.ahead, longer)
    np.add.at(allowance, layout.behind, longer)
    if task.motion is not None and task.motion.contacts is not None:
        level = (unit(LEVEL * each) for each in _edge_ends(task))
        allowance += 0.5 * diameter * np.mean(_angles(*level), axis=0)
    return allowance


def bend_lengths(task: Task, diameter: float, segment: float) -> Array:
    """Return (clasps,) [m]: by how much each of a clasp's two cables is longer for its thickness.

    Where a cable turns by ``π - φ`` about another, φ the angle between the edges there, its centre
    line follows a circle of one diameter whose far side is half a diameter from the vertex. That is
    ``(π - φ - cos(φ/2))`` diameters longer than the plan's sharp bend. A chain of segments cannot
    follow the circle; it uses up ``COARSENESS · segment²/diameter · cos(φ/2)`` besides. The result
    is the mean over the time in which the plan has a hitch, or in which it carries what it grips,
    if it does: ropes that are too short then grip harder. It is zero where there is no hitch.

    Parameters
    ----------
    task: the plan.
    diameter: of the simulated cables [m].
    segment: length of their segments [m].
    """
    layout = task.team.layout
    if not task.formed.any():
        return np.zeros(len(layout.clasps))
    leaving, arriving = _edge_ends(task)
    turn = _angles(leaving[:, layout.ahead], arriving[:, layout.behind])
    half = np.cos(0.5 * turn)
    bends = diameter * (np.pi - turn - half) + COARSENESS * segment**2 / diameter * half
    longer: Array = np.mean(bends, axis=0)
    return longer


def _edge_ends(task: Task) -> tuple[Array, Array]:
    """Return unit vectors (samples, n, 3) along edges where they begin and where they end.

    Samples are those of ``bend_lengths``.
    """
    layout, motion = task.team.layout, task.motion
    carrying = task.formed & np.any(task.cargo.carried, axis=-1)
    if motion is None or motion.contacts is None or not carrying.any():
        straight = unit(layout.edges(task.vertices[task.formed]))
        return straight, straight
    vertices = task.vertices[carrying]
    times = np.clip(task.t[carrying], *motion.contacts.breaks[[0, -1]])
    first, last = np.moveaxis(motion.contacts.at(times), 2, 0)
    return unit(first - vertices[:, layout.starts]), unit(vertices[:, layout.ends] - last)


def _angles(first: Array, second: Array) -> Array:
    """Return the angles (…) [rad] between unit vectors (…, 3)."""
    angles: Array = np.arccos(np.clip(np.sum(first * second, axis=-1), -1.0, 1.0))
    return angles
