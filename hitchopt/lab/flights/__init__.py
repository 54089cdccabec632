"""Recorded flights: what files of labs hold, and how it is compared with a plan."""
