"""Timing of paths: toppra's optimum, limited in jerk, as piecewise polynomials."""

from hitchopt.planners.timing.deferred_toppra import defer_toppra

defer_toppra()
