"""Sweeps: many plans and simulated flights, on one machine or a cluster."""
