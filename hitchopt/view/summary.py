"""summary.png: a plan at a glance."""

from __future__ import annotations

import textwrap
from pathlib import Path

from matplotlib.figure import Figure

from hitchopt.checks.certificate import Certificate
from hitchopt.motion.motion import Motion
from hitchopt.view.curves import sampled_curves
from hitchopt.view.plan_view import draw_plan_view
from hitchopt.view.style import new_figure, save_png
from hitchopt.view.time_plots import draw_legend, draw_panel, draw_phases, panels

SIZE = (13.0, 7.2)
"""Width and height [inch]."""


def draw_summary(motion: Motion, certificate: Certificate, title: str = "") -> Figure:
    """Return the picture: hitches or drones and the paths from above; what is limited over time.

    Parameters
    ----------
    motion: the plan.
    certificate: its certificate, whose worst values are marked.
    title: the problem's title.
    """
    figure = new_figure(SIZE)
    curves = sampled_curves(motion)
    shown = panels(motion, curves)
    grid = figure.add_gridspec(len(shown), 2)
    draw_plan_view(figure.add_subplot(grid[:, 0]), motion, curves)
    axes = [figure.add_subplot(grid[row, 1]) for row in range(len(shown))]
    for each, panel in zip(axes, shown, strict=True):
        draw_panel(each, curves.t, panel, certificate)
    draw_phases(axes, motion.phases, motion.duration)
    for each in axes[:-1]:
        each.tick_params(labelbottom=False)
    axes[-1].set_xlabel("t [s]")
    draw_legend(axes[-1])
    figure.align_ylabels(axes)
    figure.suptitle(_headline(motion, certificate, title), fontsize="large", parse_math=False)
    return figure


def save_summary(path: Path, motion: Motion, certificate: Certificate, title: str = "") -> None:
    """Draw the picture and write it as a PNG.

    Parameters
    ----------
    path: the file, replaced if it exists.
    motion, certificate, title: as in ``draw_summary``.

    Raises
    ------
    OSError: the file cannot be written.
    """
    save_png(draw_summary(motion, certificate, title), path)


def _headline(motion: Motion, certificate: Certificate, title: str) -> str:
    total = len(certificate.checks)
    if certificate.certified:
        verdict = f"certified for all t: {total} of {total} limits hold"
    else:
        verdict = "NOT CERTIFIED: " + ", ".join(check.name for check in certificate.violated)
    drones = f"{len(motion.team.drone_names)} drones"
    who = f"{motion.team.robots} robots, {drones}" if motion.team.has_cables else drones
    facts = f"{who}, {motion.duration:.4g} s; {verdict}"
    name = textwrap.shorten(title, 100, placeholder=" …")
    return f"{name}\n{facts}" if name else facts
