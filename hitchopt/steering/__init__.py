"""Certified plans to new goals from moving states."""
