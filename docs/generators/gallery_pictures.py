"""Pictures of all problems for the gallery: ``make gallery`` draws missing ones.

They are committed, since planning all problems takes minutes. Delete a picture to draw it again.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

import hitchopt as ho
from generators.problem_collection import SECTIONS
from hitchopt.mission.problem import TeamMission
from hitchopt.values import Array
from hitchopt.view.painter import draw_plan_storyboard, shots_in_motion
from hitchopt.view.pictures import draw_plan_view
from hitchopt.view.style import COLOURS, INK, new_figure, save_figure

SIZE = (4.2, 4.2)
"""Width and height [inch]."""

EDGES = {"left": 0.01, "right": 0.99, "bottom": 0.01, "top": 0.92}
"""Edges of storyboards, as fractions of the figure."""

PALETTE = 64
"""Number of colours: line drawings need few, and files shrink to a third."""


PANELS = 4
"""Number of panels of a storyboard."""

CARD_WIDTH = 200.0
"""Width of a picture on a card of the gallery [pixels]."""

CAPTION_HEIGHT = 9.0
"""Least size of captions there [pixels]."""

MAX_CAPTION = 22
"""Maximum number of characters of a caption; longer ones, of several teams, are cut to the time."""


def draw(file: Path, *, solved: bool) -> Figure:
    """Return the picture of a problem.

    Plans of hitches are storyboards, those of single drones are seen from above. A problem without
    a plan is drawn as its task.
    """
    plan = ho.solve(file) if solved else None
    if plan is not None and plan.flight.has_cables:
        figure = new_figure(SIZE, None)
        shots = shots_in_motion(plan.flight, PANELS)
        chosen = np.unique(np.linspace(0, len(shots) - 1, PANELS).round().astype(int))
        place = figure.add_gridspec(1, 1, **EDGES)[0]
        draw_plan_storyboard(place, plan.flight, [shots[i] for i in chosen])
        for axes in figure.axes:
            if len(axes.get_title()) > MAX_CAPTION:
                axes.set_title(axes.get_title().rpartition(", ")[2])
            axes.title.set_fontsize(CAPTION_HEIGHT * 72.0 * SIZE[0] / CARD_WIDTH)
        return figure
    figure = new_figure(SIZE)
    axes = figure.add_subplot()
    if plan is not None:
        draw_plan_view(axes, plan.flight)
        if legend := axes.get_legend():
            legend.remove()
    else:
        draw_task(axes, ho.load_problem(file))
    axes.set_axis_off()
    return figure


def draw_task(axes: Axes, problem: ho.Problem) -> None:
    """Draw the starts and all outlines or goals of all teams, the last ones in colour."""
    for prism in problem.keep_out:
        axes.add_patch(Polygon(prism.polygon.vertices, fc="0.88", ec="0.4", hatch="////"))
    for mission in problem.teams.values():
        if mission.team.has_cables:
            draw_outlines(axes, mission)
        else:
            draw_flights(axes, mission)
    if problem.arena is not None:
        (x, y), (right, back) = problem.arena.lower[:2], problem.arena.upper[:2]
        box = [(x, y), (x, back), (right, back), (right, y)]
        axes.add_patch(Polygon(box, fill=False, ec="0.4"))
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.set(xlabel="x [m]", ylabel="y [m]")


def draw_flights(axes: Axes, mission: TeamMission) -> None:
    """Draw the places of single drones between flights, the goals in colour."""
    places = [mission.start, *(step.goal for step in mission.steps if isinstance(step, ho.Fly))]
    for start, goal in pairwise(places):
        lines = [[a[:2], b[:2]] for a, b in zip(start, goal, strict=True)]
        axes.add_collection(LineCollection(lines, colors="0.72", linestyles="dashed"))
        axes.plot(*start[:, :2].T, "o", mfc="white", mec=COLOURS[0])
        axes.plot(*goal[:, :2].T, "o", color=COLOURS[0])


def draw_outlines(axes: Axes, mission: TeamMission) -> None:
    """Draw the cables at the start and the outlines of all steps, the last one in colour."""
    after = [mission.start_outline]
    for step in mission.steps:
        after.append(step.checked_polygon_after(mission.team, after[-1]))
    polygons = [each for each in after if each is not None]
    for i, each in enumerate(polygons):
        last = i == len(polygons) - 1
        x, y = np.vstack([each.vertices, each.vertices[:1]][: 1 + mission.team.layout.closed]).T
        axes.plot(x, y, color=COLOURS[0] if last else "0.62", ls="-" if last else "--", lw=2)
    cables = starting_cables(mission)
    axes.add_collection(LineCollection(list(cables), colors=INK, linewidths=0.8))
    axes.plot(*cables[:, 0].T, "o", color=INK, ms=4)
    axes.plot(*cables[:, -1].T, "s", mfc="white", mec=INK, ms=4)


def starting_cables(mission: TeamMission) -> Array:
    """Return the cables (n, 2 or 4, 2) [m] from drone to drone; n = 0 without a feasible hitch."""
    start, team = mission.start, mission.team
    if isinstance(start, ho.DronesStart):
        return np.stack([start.q, start.r], axis=1)[..., :2]
    try:
        hitch = start if isinstance(start, ho.Hitch) else ho.Hitch.balanced(team, start.polygon)
    except ho.InfeasibleError:  # an edge as long as its cable
        return np.zeros((0, 2, 2))
    drones, points = hitch.drones.reshape(-1, 2, 3), hitch.vertices
    parts = [drones[:, 0], points[team.layout.starts], points[team.layout.ends], drones[:, 1]]
    return np.stack(parts, axis=1)[..., :2]


def main() -> None:
    """Draw missing pictures."""
    for section in SECTIONS:
        for file in section.files:
            target = section.picture(file)
            if target.exists():
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            save_figure(draw(file, solved=section.solved), target)
            Image.open(target).convert("RGB").quantize(PALETTE).save(target, optimize=True)
            sys.stdout.write(f"{target}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
