"""Ways for a morph where the straight one is shut: guesses, a casadi NLP, refinement."""
