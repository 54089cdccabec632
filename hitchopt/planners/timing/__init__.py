"""Timing of paths: toppra's optimum with a jerk limit, as piecewise polynomials."""
