"""Optimised routes of a morph: guesses, a search at rest, and refinement with the clock."""
