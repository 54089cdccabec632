"""Rigid objects that a team carries or avoids, independent of cables and time."""

from hitchopt.objects.bodies import Clearance, Rim, Section, Slab, SolidObject

__all__ = ["Clearance", "Rim", "Section", "Slab", "SolidObject"]
