"""Reactions of a team to the loss of one of its drones: planned, certified, counted."""
