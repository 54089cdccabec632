"""Card of a plan in a notebook: its picture, phases and certificate."""

from __future__ import annotations

import warnings
from base64 import b64encode
from html import escape
from io import BytesIO

from matplotlib.axes import Axes

from hitchopt.checks.certificate import Certificate, html_table
from hitchopt.motion.motion import Motion
from hitchopt.view.curves import sampled_curves
from hitchopt.view.plan_view import draw_plan_view
from hitchopt.view.summary import draw_summary

CARD_RESOLUTION = 65
"""Resolution of the picture [dots per inch]: 850 pixels wide."""


def plan_card(motion: Motion, certificate: Certificate, title: str) -> str:
    """Return the card as HTML without an outside address."""
    picture = BytesIO()
    with warnings.catch_warnings():
        # A title in a script that the font lacks is drawn with boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        draw_summary(motion, certificate, title).savefig(picture, dpi=CARD_RESOLUTION)
    image = b64encode(picture.getvalue()).decode()
    phases = html_table(
        ("phase", "step", "start", "end", "remark"),
        [
            (p.name, str(p.step), f"{p.start:.3f} s", f"{p.end:.3f} s", p.remark)
            for p in motion.phases
        ],
    )
    headline = f"{len(motion.team.drone_names)} drones, {motion.duration:.4g} s"
    return (
        f"<p><b>{escape(title or 'Plan')}</b>: {headline}</p>"
        f'<img alt="the plan at a glance" src="data:image/png;base64,{image}"/>'
        f"{phases}{certificate._repr_html_()}"
    )


def plot_from_above(motion: Motion, axes: Axes | None) -> Axes:
    """Draw the plan from above on axes, by default on those of a new figure of pyplot's."""
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=(6.5, 7.0), layout="constrained")[1]
    draw_plan_view(axes, motion, sampled_curves(motion))
    return axes
