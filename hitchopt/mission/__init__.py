"""Floor 7: problem files, and a problem to a plan, step by step."""
