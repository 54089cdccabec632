"""Bounds for all of continuous time that several checks share."""
