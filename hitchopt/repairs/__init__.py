"""Repair: the smallest changes that make a problem feasible, each verified by planning it."""
