"""What ropes that are simulated thick ask for, so that their hitch is the plan's.

Real cables are thinner by far: both corrections mend the simulation, and no flight. Where a cable
goes around another, its middle keeps one diameter from the other's, whose far side is half a
diameter from the vertex: the bend takes length, and its two straight parts do not meet at the
vertex but pass it aside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.simulation.setpoint_tables import Setpoints, VertexTable

Array = NDArray[np.float64]


def thickness_allowance(team: Team, vertices: VertexTable, diameter: float) -> Array:
    """Return (n,) [m]: by how much cables must be longer to bend around each other so thick.

    Where a cable turns by ``π - φ`` about another, φ the polygon's exterior angle there, its middle
    goes around a circle of one diameter whose far side is half a diameter from the vertex. That is
    ``(π - φ - cos(φ/2))`` diameters longer than the plan's sharp bend. The mean over the plan's
    time; real cables are thinner by far, so that this mends the simulation and no flight.

    Parameters
    ----------
    team: whose cables they are.
    vertices: the plan's.
    diameter: of the simulated cables [m].
    """
    allowance = np.zeros(team.robots)
    if not len(vertices.t):
        return allowance
    layout = team.layout
    edges = layout.edges(vertices.positions)
    u = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    cosine = np.sum(u[:, layout.ahead] * u[:, layout.behind], axis=-1)
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    longer = diameter * np.mean(np.pi - turn - np.cos(0.5 * turn), axis=0)
    np.add.at(allowance, layout.ahead, longer)
    np.add.at(allowance, layout.behind, longer)
    return allowance


def thickness_offsets(
    team: Team, setpoints: Setpoints, vertices: VertexTable, diameter: float
) -> Array:
    """Return (samples, 2n, 3) [m]: how far aside drones stand so that legs run as planned.

    Square to its leg, away from its edge, by ``1 - sin(h)/2`` diameters, h being half of the angle
    between leg and edge: as far as the leg passes the vertex aside. A leg from where the plan has
    its drone would be turned by that over its length instead, by a degree or so, and a vertex
    dragged inward by centimetres, as little as holds it there. In proportion to the tension while
    a hitch is drawn tight; none at a chain's ends, and where there is no hitch.

    So it is for bends that lie in the hitch's plane. Those of a flat hitch pass over and under each
    other besides, and their straight parts some 2 mm farther aside (simulated, 12 mm thick): a
    quarter of a degree that is left. An edge is shifted by as much at each of its ends, to the same
    side, and turned only by what its ends differ: at most half a diameter over its length.

    Parameters
    ----------
    team: whose cables they are.
    setpoints, vertices: the plan's.
    diameter: of the simulated cables [m].
    """
    offsets = np.zeros_like(setpoints.positions)
    if not len(vertices.t):
        return offsets
    layout = team.layout
    samples = np.clip(np.searchsorted(setpoints.t, vertices.t), 0, len(setpoints.t) - 1)
    edges = _unit(layout.edges(vertices.positions))
    drawn = np.clip(vertices.tensions / team.tension, 0.0, 1.0)
    for end, sign in ((0, 1.0), (1, -1.0)):
        drones = 2 * np.flatnonzero(layout.has_leg[:, end]) + end
        along = sign * edges[:, drones // 2]
        standing = setpoints.positions[samples][:, drones]
        legs = _unit(standing - vertices.positions[:, layout.anchors[drones]])
        cosine = np.sum(legs * along, axis=-1, keepdims=True)
        aside = _unit(along - cosine * legs)
        half = 0.5 * np.arccos(np.clip(cosine, -1.0, 1.0))
        size = diameter * (1.0 - 0.5 * np.sin(half)) * drawn[:, drones // 2, None]
        offsets[samples[:, None], drones] = -size * aside
    return offsets


def _unit(vectors: Array) -> Array:
    """Return directions (…, 3); zero of what has none."""
    sizes = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = np.divide(vectors, sizes, out=np.zeros_like(vectors), where=sizes > 0.0)
    return unit
