"""Stops, changes of rate and aborts of a plan in flight."""
