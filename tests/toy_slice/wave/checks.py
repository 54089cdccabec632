"""The report ``wave_height``: how far vertices rise above their start."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.rule import ReportRule, SpanResults, WorstCase
from hitchopt.motion.motion import Motion


def _height(motion: Motion, _results: SpanResults, _gamma: float) -> WorstCase:
    """Return the largest rise [m], by the convex hulls of Bernstein coefficients."""
    heights = motion.vertices.coefficients[:, :, 2]
    rises = np.max(heights, axis=(1, 2)) - np.min(heights[0, :, 0])
    piece = int(np.argmax(rises))
    return WorstCase(float(rises[piece]), float(motion.vertices.breaks[piece]))


WAVE_HEIGHT = ReportRule(
    "wave_height",
    "m",
    "max",
    _height,
    limit=lambda _: None,
    remedy="",
    free_remedy="",
    assumes_gamma=False,
    group="motion",
    proves="how far vertices rise above their start [m]",
)

TEAM_REPORTS = (WAVE_HEIGHT,)
