"""Where markers go on each cable before a flight, and the standard errors that they will give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.errors import OneLine
from hitchopt.flights.recordings import WINDOW_TIGHT, tight
from hitchopt.flights.vertices import crossing_errors, line_variances
from hitchopt.geometry.vectors import length, unit
from hitchopt.simulation.task import Task
from hitchopt.values import Array

CLEAR = 0.05  # Distance from a clasp within which thick cables are bent [m]
MARKERS, SHORTEST = 3, 0.1  # Markers of an edge, and the shortest stretch that they fit on [m]
SCATTER = 1e-3  # Assumed scatter of markers about the lines of cables [m]


@dataclass(frozen=True, eq=False)
class MarkerPlan(OneLine):
    """Markers of every cable, and the errors of vertices that they give.

    Attributes
    ----------
    stretches: (n, 2) [m], from q's end: the part of each cable that stays on its edge while the
        hitch is drawn tight; its end is before its beginning if there is none.
    places: of each cable, where its markers go [m] from q's end.
    standard_errors: (points, 2) [m], median and largest over time, of markers that scatter by
        SCATTER; nan at the ends of a chain, infinite without two markers on both edges.
    """

    stretches: Array
    places: tuple[Array, ...]
    standard_errors: Array


def marker_plan(task: Task) -> MarkerPlan:
    """Return where markers go on the cables of a plan's hitch.

    On a stretch that never leaves the edge there are three, as far apart as can be. If a cable
    slides too far for that, markers follow one another such that three are on the edge at any time.
    """
    layout, hitched = task.team.layout, tight(task, task.t - task.t[0], WINDOW_TIGHT)
    vertices, drones = task.vertices[hitched], task.setpoints.positions[hitched]
    edges, starts = layout.edges(vertices), length(drones - vertices[:, layout.anchors])[:, ::2]
    begins, ends = starts + CLEAR, starts + length(edges) - CLEAR
    stretches = np.column_stack([np.max(begins, axis=0), np.min(ends, axis=0)])
    places = []
    for k, (lower, upper) in enumerate(stretches):
        if upper - lower >= SHORTEST:
            places.append(np.linspace(lower, upper, MARKERS))
        else:
            step = max(float(np.min(ends[:, k] - begins[:, k])), SHORTEST) / MARKERS
            places.append(np.arange(np.min(begins[:, k]), np.max(ends[:, k]) + 0.5 * step, step))
    relative = np.full((len(vertices), 2, len(places)), np.inf)  # At both ends of the edges
    for k, each in enumerate(places):
        on = (each >= begins[:, k, None]) & (each <= ends[:, k, None])
        s, count = each - starts[:, k, None], np.sum(on, axis=1)
        mean = np.sum(s * on, axis=1) / np.maximum(count, 1)
        squares = np.sum((s - mean[:, None]) ** 2 * on, axis=1)
        markers, enough = np.column_stack([count, mean, squares]), count >= 2
        for end, at in enumerate((np.zeros(len(s)), length(edges[:, k]))):
            relative[enough, end, k] = line_variances(markers[enough], at[enough])
    u = unit(edges[..., :2])
    before, after = u[:, layout.behind], u[:, layout.ahead]
    sine = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    both = SCATTER**2 * (relative[:, 1, layout.behind] + relative[:, 0, layout.ahead])
    each = crossing_errors(both, sine)
    errors = np.full((layout.points, 2), np.nan)
    if len(each):
        errors[layout.clasps] = np.column_stack([np.median(each, axis=0), np.max(each, axis=0)])
    return MarkerPlan(stretches, tuple(places), errors)
