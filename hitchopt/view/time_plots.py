"""Separation, speed and thrust over time, against their limits and the certificate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import blended_transform_factory

from hitchopt.checks import separation, speed, thrust
from hitchopt.checks.certificate import Certificate
from hitchopt.checks.rule import CheckRule
from hitchopt.motion.motion import Motion, Phase
from hitchopt.values import Array
from hitchopt.view.curves import Curves
from hitchopt.view.style import DASHES, INK, LIMIT_COLOUR, legend_below, marker

FORBIDDEN = "0.8"
HATCH = "////"

CURVE = 1.4
"""Width of a curve [points]."""

ENDLESS = 1e9
"""Largest worst value that is drawn: larger ones say that nothing was counted or bounded."""

LINE = 11.0
"""Height of a line of small text [points]."""

HEIGHT = 110.0
"""Approximate height of a panel [points]."""

CHARACTER = 0.013
"""Width of a character of a phase's name as a share of the axes' width."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One quantity over time.

    Attributes
    ----------
    label: its name and unit.
    rule: the certificate's rule for it.
    values: the curve (samples,), in the label's unit.
    limit: its limit, in the same unit.
    factor: the label's unit over the certificate's; nan: values are shares of the limit.
    """

    label: str
    rule: CheckRule
    values: Array
    limit: float
    factor: float = 1.0


def panels(motion: Motion, curves: Curves) -> tuple[Panel, ...]:
    """Return the quantities from top to bottom; thrust is a share if drones differ.

    A single drone has no separation.
    """
    kinds = np.unique(motion.team.max_thrust)
    if len(kinds) == 1:
        limit = float(kinds[0])
        forces = Panel("largest\nthrust [N]", thrust.RULE, limit * curves.thrust, limit)
    else:
        forces = Panel("largest thrust\n/ its limit", thrust.RULE, curves.thrust, 1.0, math.nan)
    rates = Panel(
        "largest\nspeed [m/s]", speed.RULE, curves.speed, motion.requirements.limits.speed
    )
    if len(motion.team.drone_names) < 2:
        return (rates, forces)
    distances = Panel("smallest\nseparation [–]", separation.RULE, curves.separation, 1.0)
    return (distances, rates, forces)


def draw_panel(axes: Axes, t: Array, panel: Panel, certificate: Certificate) -> None:
    """Draw one quantity, its limit, the forbidden side and the certificate's worst.

    Parameters
    ----------
    axes: what to draw on.
    t: times (samples,) [s]
    panel: the quantity.
    certificate: the plan's certificate.
    """
    axes.plot(t, panel.values, color=INK, linewidth=CURVE, zorder=3)
    worst = worst_of(panel, certificate)
    top = 1.22 * max(panel.limit, float(np.max(panel.values)), worst[1] if worst else 0.0)
    axes.set_ylim(0.0, top)
    axes.axhline(panel.limit, color=LIMIT_COLOUR, linewidth=1.2, linestyle=DASHES, zorder=2)
    forbidden = (0.0, panel.limit) if panel.rule.sense == "min" else (panel.limit, top)
    axes.axhspan(
        *forbidden, facecolor="none", edgecolor=FORBIDDEN, hatch=HATCH, linewidth=0, zorder=0
    )
    _label(axes, f"limit {panel.limit:.4g}", panel.limit, LIMIT_COLOUR)
    if worst is not None:
        _mark(axes, *worst, float(t[-1]))
        _label(axes, f"worst {worst[1]:.4g}", worst[1], INK, _shift(panel, worst[1], top))
    axes.set_ylabel(panel.label)
    axes.set_xlim(float(t[0]), float(t[-1]))
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def draw_phases(axes: Sequence[Axes], phases: Sequence[Phase], duration: float) -> None:
    """Shade every other phase on all axes, and name the phases whose names fit on the first.

    Parameters
    ----------
    axes: the panels' axes from top to bottom.
    phases: the plan's phases.
    duration: the plan's duration [s].
    """
    for i, phase in enumerate(phases):
        for each in axes:
            if i % 2:
                each.axvspan(phase.start, phase.end, color="0.93", linewidth=0, zorder=-1)
            if i > 0:
                each.axvline(phase.start, color="0.6", linewidth=0.7, linestyle=":", zorder=1)
        if (phase.end - phase.start) / duration > CHARACTER * (len(phase.name) + 1):
            middle = (0.5 * (phase.start + phase.end), 1.0)
            axes[0].annotate(
                phase.name, middle, (0, 4), xycoords=axes[0].get_xaxis_transform(),
                textcoords="offset points", ha="center", fontsize="small", parse_math=False,
            )  # fmt: skip


def draw_legend(axes: Axes) -> None:
    """Draw the legend below the lowest axes."""
    handles = [
        Line2D([], [], color=INK, linewidth=CURVE, label="worst drone or pair"),
        Line2D([], [], color=LIMIT_COLOUR, linestyle=DASHES, label="limit"),
        _worst_marker(),
        Patch(facecolor="none", edgecolor=FORBIDDEN, hatch=HATCH, linewidth=0, label="forbidden"),
    ]
    legend_below(axes, handles, 0.32, 2)


def worst_of(panel: Panel, certificate: Certificate) -> tuple[float, float] | None:
    """Return time and value of the certificate's worst, in the panel's unit, if it has one."""
    for check in certificate.checks:
        if check.name == panel.rule.name:
            factor = panel.factor if math.isfinite(panel.factor) else 1.0 / check.number
            value = check.bound * factor
            return (check.time, value) if abs(value) < ENDLESS else None
    return None


def _mark(axes: Axes, time: float, value: float, end: float) -> None:
    axes.plot([time, end], [value, value], color=INK, linewidth=0.6, linestyle=":", zorder=2)
    worst = _worst_marker()
    worst.set(data=([time], [value]), clip_on=False, zorder=5)
    axes.add_line(worst)


def _worst_marker() -> Line2D:
    line = marker("D", "white", INK, "worst for all t, from the certificate")
    line.set_markeredgewidth(CURVE)
    return line


def _label(axes: Axes, text: str, value: float, colour: str, shift: float = 0.0) -> None:
    """Write a text on the right of the axes, where no curve can be."""
    transform = blended_transform_factory(axes.transAxes, axes.transData)
    axes.annotate(
        text, (1.0, value), (5.0, shift), xycoords=transform, textcoords="offset points",
        va="center", fontsize="small", color=colour, annotation_clip=False,
    )  # fmt: skip


def _shift(panel: Panel, value: float, top: float) -> float:
    """Return the offset [points] that separates the worst value's label from the limit's."""
    gap = (value - panel.limit) / top * HEIGHT
    upward = gap > 0.0 if gap != 0.0 else panel.rule.sense == "min"
    missing = max(LINE - abs(gap), 0.0)
    return missing if upward else -missing
