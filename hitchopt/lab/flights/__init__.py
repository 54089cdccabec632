"""Recorded flights: contents of recordings, and their comparison with a plan."""
