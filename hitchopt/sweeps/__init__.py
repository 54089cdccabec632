"""Sweeps: many plans, simulated flights and statics, on one machine or a cluster."""
