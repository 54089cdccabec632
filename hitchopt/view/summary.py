"""summary.png: a plan at a glance."""

from __future__ import annotations

import textwrap
import warnings
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hitchopt.checks.certificate import Certificate
from hitchopt.motion.motion import Motion
from hitchopt.view.curves import sampled_curves
from hitchopt.view.plan_view import draw_plan_view
from hitchopt.view.swarm_view import draw_swarm_view
from hitchopt.view.time_plots import draw_legend, draw_panel, draw_phases, panels

SIZE = (13.0, 7.2)
"""[inch]"""

RESOLUTION = 120
"""[dots per inch]"""


def draw_summary(motion: Motion, certificate: Certificate, title: str = "") -> Figure:
    """Return the picture: hitches or drones and the paths from above; what is limited over time.

    Parameters
    ----------
    motion: the plan.
    certificate: of that plan; its worst values are marked.
    title: what the problem is called.
    """
    figure = Figure(figsize=SIZE, dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    curves = sampled_curves(motion)
    shown = panels(motion, curves)
    grid = figure.add_gridspec(len(shown), 2)
    above = figure.add_subplot(grid[:, 0])
    if motion.team.has_cables:
        draw_plan_view(above, motion, curves)
    else:
        draw_swarm_view(above, motion, curves)
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
    path: of the file, replaced if there is one.
    motion, certificate, title: as in ``draw_summary``.

    Raises
    ------
    OSError: the file cannot be written.
    """
    figure = draw_summary(motion, certificate, title)
    with warnings.catch_warnings():
        # A title in a script that the font lacks is drawn with boxes, which is no news to anyone.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(path, format="png", dpi=RESOLUTION, metadata={"Software": None})


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
