"""Problem files, and a problem to a plan, step by step."""
