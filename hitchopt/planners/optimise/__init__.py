"""Paths of a morph around obstacles: initial guesses, a casadi NLP, and refinement."""
