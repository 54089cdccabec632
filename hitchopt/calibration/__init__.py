"""Estimates of cable lengths, stiffness and friction from recorded flights."""
