"""Paths for a morph where the straight one is blocked: guesses, a casadi NLP, refinement."""
