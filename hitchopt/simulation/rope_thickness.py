"""Corrections for simulated ropes that are thicker than real cables.

Both corrections concern the simulation alone, not the flight. Where a cable goes around another,
its centre line keeps one diameter from the other's, whose far side is half a diameter from the
vertex: the bend takes length, and its two straight parts do not meet at the vertex but pass it at a
distance. Segments that are longer than the bend is wide use up more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import unit
from hitchopt.simulation.flight_task import Task

Array = NDArray[np.float64]


COARSENESS = 0.15
"""Length that coarse segments use up in a bend of 180°, over the square of a segment's length over
the diameter: within 1 mm at a clasp for regular hitches of n = 3, 6, 12 with segments of 30 mm, and
n = 3, 6 with 10 mm (12 mm thick, 10 g/m at 0.5 N)."""


def thickness_allowance(task: Task, diameter: float, segment: float) -> Array:
    """Return (n,) [m]: the additional length with which thick cables bend around each other.

    Where a cable turns by ``π - φ`` about another, φ the polygon's exterior angle there, its centre
    line follows a circle of one diameter whose far side is half a diameter from the vertex. That is
    ``(π - φ - cos(φ/2))`` diameters longer than the plan's sharp bend. A chain of segments cannot
    follow the circle; it uses up ``COARSENESS · segment²/diameter · cos(φ/2)`` besides. The result
    is the mean over the time in which the plan has a hitch.

    Parameters
    ----------
    task: the plan.
    diameter: of the simulated cables [m].
    segment: length of their segments [m].
    """
    layout = task.team.layout
    allowance = np.zeros(task.team.robots)
    if task.formed.any():
        u = unit(layout.edges(task.vertices[task.formed]))
        cosine = np.sum(u[:, layout.ahead] * u[:, layout.behind], axis=-1)
        turn = np.arccos(np.clip(cosine, -1.0, 1.0))
        half = np.cos(0.5 * turn)
        bends = diameter * (np.pi - turn - half) + COARSENESS * segment**2 / diameter * half
        longer = np.mean(bends, axis=0)
        np.add.at(allowance, layout.ahead, longer)
        np.add.at(allowance, layout.behind, longer)
    return allowance


def thickness_offsets(task: Task, diameter: float) -> Array:
    """Return (samples, 2n, 3) [m]: the offsets of drones at which thick legs run as planned.

    An offset is perpendicular to the leg, away from the edge, ``1 - sin(h)/2`` diameters long, h
    being half of the angle between leg and edge: the distance at which the leg passes the vertex.
    Without it a leg would be turned by that distance over its length, by a degree or so, and a
    vertex dragged inward by centimetres, since little holds it there. Offsets are proportional to
    the tension while a hitch is drawn tight; they are zero at a chain's ends, and without a hitch.

    They are exact for bends in the plane of the hitch. The bends of a flat hitch also pass over and
    under each other, and their straight parts are some 2 mm farther apart (simulated, 12 mm thick):
    a quarter of a degree remains. An edge is displaced by as much at each of its ends, to the same
    side, and turned only by the difference of its ends: at most half a diameter over its length.

    Parameters
    ----------
    task: the plan.
    diameter: of the simulated cables [m].
    """
    layout, rows = task.team.layout, np.flatnonzero(task.formed)
    offsets, vertices = np.zeros_like(task.setpoints.positions), task.vertices[rows]
    edges = unit(layout.edges(vertices))
    drawn = np.clip(task.tensions[rows] / task.team.tension, 0.0, 1.0)
    for end, sign in ((0, 1.0), (1, -1.0)):
        drones = 2 * np.flatnonzero(layout.has_leg[:, end]) + end
        along = sign * edges[:, drones // 2]
        positions = task.setpoints.positions[rows][:, drones]
        legs = unit(positions - vertices[:, layout.anchors[drones]])
        cosine = np.sum(legs * along, axis=-1, keepdims=True)
        aside = unit(along - cosine * legs)
        half = 0.5 * np.arccos(np.clip(cosine, -1.0, 1.0))
        size = diameter * (1.0 - 0.5 * np.sin(half)) * drawn[:, drones // 2, None]
        offsets[rows[:, None], drones] = -size * aside
    return offsets
