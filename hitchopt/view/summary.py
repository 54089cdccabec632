"""summary.png: a plan at a glance."""

from __future__ import annotations

import textwrap
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from hitchopt.checks.certificate import Certificate
from hitchopt.motion.motion import Motion
from hitchopt.view.curves import Curves, sampled_curves
from hitchopt.view.house_colours import facts, verdict
from hitchopt.view.plan_view import draw_plan_view
from hitchopt.view.storyboard import FEW, chosen_shots, draw_plan_storyboard
from hitchopt.view.style import new_figure, save_figure
from hitchopt.view.time_plots import draw_legend, draw_panel, draw_phases, panels

SIZE = (13.0, 7.2)
"""Width and height [inch]."""

WIDTHS = (1.25, 1.0)
"""Widths of what is left and of what is right."""

LEGEND_GAP = 0.17
"""Distance of the legend from such a plan, as a share of its height."""

LABEL_AT = -0.1
"""Where the panels' labels stand, as a share of their width: aligning them costs a tenth of all."""

HEIGHTS = (1.0, 1.25)
"""Heights of few panels and of the plan from above, which is drawn as well then."""


def draw_summary(motion: Motion, certificate: Certificate, title: str = "") -> Figure:
    """Return the picture: a storyboard, or single drones from above; what is limited over time.

    Parameters
    ----------
    motion: the plan.
    certificate: its certificate, whose worst values are marked.
    title: the problem's title.
    """
    figure = new_figure(SIZE)
    curves = sampled_curves(motion)
    shown = panels(motion, curves)
    grid = figure.add_gridspec(len(shown), 2, width_ratios=WIDTHS)
    _draw_left(figure, grid[:, 0], motion, curves)
    axes = [figure.add_subplot(grid[row, 1]) for row in range(len(shown))]
    for each, panel in zip(axes, shown, strict=True):
        draw_panel(each, curves.t, panel, certificate)
    draw_phases(axes, motion.phases, motion.duration)
    for each in axes:
        each.yaxis.set_label_coords(LABEL_AT, 0.5)
    for each in axes[:-1]:
        each.tick_params(labelbottom=False)
    axes[-1].set_xlabel("t [s]")
    draw_legend(axes[-1])
    figure.suptitle(_headline(motion, certificate, title), fontsize="large", parse_math=False)
    return figure


def _draw_left(figure: Figure, place: SubplotSpec, motion: Motion, curves: Curves) -> None:
    """Draw what is left of the limits.

    Few moments leave room for the plan from above, or for a few cables where there are many.
    """
    shots = chosen_shots(motion) if motion.team.has_cables else ()
    if len(shots) > FEW:
        draw_plan_storyboard(place, motion, shots)
        return
    if shots:
        above = place.subgridspec(2, 1, height_ratios=HEIGHTS)
        near = [shot for shot in shots if shot.near]
        if near:
            draw_plan_storyboard(above[1], motion, near)
        else:
            draw_plan_view(figure.add_subplot(above[1]), motion, curves, LEGEND_GAP)
        draw_plan_storyboard(above[0], motion, [shot for shot in shots if not shot.near])
    else:
        draw_plan_view(figure.add_subplot(place), motion, curves)


def save_summary(path: Path, motion: Motion, certificate: Certificate, title: str = "") -> None:
    """Draw the picture and write it as PNG, SVG or PDF, by the name's ending.

    Parameters
    ----------
    path: the file, replaced if it exists.
    motion, certificate, title: as in ``draw_summary``.

    Raises
    ------
    OSError: the file cannot be written.
    """
    save_figure(draw_summary(motion, certificate, title), path)


def _headline(motion: Motion, certificate: Certificate, title: str) -> str:
    said = f"{facts(motion)}; {verdict(certificate)}"
    name = textwrap.shorten(title, 100, placeholder=" …")
    return f"{name}\n{said}" if name else said
