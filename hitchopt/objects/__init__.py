"""Rigid objects that a team carries or keeps off. They know no cable and no time."""

from hitchopt.objects.section import Section as Section
from hitchopt.objects.slab import Clearance as Clearance
from hitchopt.objects.slab import Slab as Slab
from hitchopt.objects.solid_object import Rim as Rim
from hitchopt.objects.solid_object import SolidObject as SolidObject
