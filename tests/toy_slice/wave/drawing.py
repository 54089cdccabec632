"""The picture of a wave."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hitchopt.plan import Plan


def draw_wave(plan: Plan, file: Path | str) -> None:
    """Draw the heights of vertices over time to a file."""
    times = np.linspace(0.0, plan.duration, 200)
    figure = Figure()
    axes = figure.subplots()
    axes.plot(times, plan.at(times).vertices[..., 2])
    axes.set(xlabel="t [s]", ylabel="height [m]")
    figure.savefig(file)
