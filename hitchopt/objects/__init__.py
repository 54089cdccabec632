"""Rigid objects that a team carries or keeps off. They know no cable and no time."""

from hitchopt.objects.bodies import Clearance, Rim, Section, Slab, SolidObject

__all__ = ["Clearance", "Rim", "Section", "Slab", "SolidObject"]
