"""Timing of paths: toppra's optimum, limited in jerk, as piecewise polynomials."""

from hitchopt.planners.timing.deferred_pyplot import defer_pyplot

defer_pyplot()
