"""Timing of paths: toppra's optimum, limited in jerk, as piecewise polynomials."""
