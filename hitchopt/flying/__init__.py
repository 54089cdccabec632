"""Setpoints streamed to a fleet, steered by an operator, with landings prepared before."""
