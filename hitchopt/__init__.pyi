"""The public names of ``__init__.py``, for type checkers and editors."""

from hitchopt.api import export as export, morph as morph, morphs as morphs, solve as solve
from hitchopt.checks import Certificate as Certificate, Check as Check, certify as certify
from hitchopt.checks.custom import ClaspSpans as ClaspSpans, DroneSpans as DroneSpans, Rule as Rule
from hitchopt.checks.custom import VertexSpans as VertexSpans
from hitchopt.errors import HitchoptError as HitchoptError, InfeasibleError as InfeasibleError
from hitchopt.errors import InputError as InputError, UnitWarning as UnitWarning
from hitchopt.exports.lint import lint as lint
from hitchopt.geometry import ConvexArc as ConvexArc, ConvexPolygon as ConvexPolygon
from hitchopt.geometry import regular_polygon as regular_polygon
from hitchopt.hitch import Hitch as Hitch, Quadrotor as Quadrotor, Swarm as Swarm, Team as Team
from hitchopt.hitch.casadi_model import model as model
from hitchopt.drones.controllers import Gains as Gains, Tube as Tube
from hitchopt.hitch.requirements import Arena as Arena, Limits as Limits, Prism as Prism
from hitchopt.hitch.requirements import Separation as Separation
from hitchopt.lab.flights.evaluation import evaluate as evaluate
from hitchopt.lab.flights.readers import read_flight as read_flight
from hitchopt.lab.simulation.report import simulate as simulate
from hitchopt.lab.statics.calibrate import calibrate as calibrate
from hitchopt.lab.statics.equilibrium import equilibrium as equilibrium
from hitchopt.carrying.outline_fit import fit as fit
from hitchopt.lab.statics.tolerance import tolerance as tolerance
from hitchopt.live.player import Player as Player
from hitchopt.live.replanner import Replanner as Replanner
from hitchopt.mission.cache import Cache as Cache
from hitchopt.mission.loading import load_problem as load_problem
from hitchopt.mission.loading import problem_from_dict as problem_from_dict
from hitchopt.mission.others import Other as Other
from hitchopt.mission.problem import Problem as Problem
from hitchopt.mission.starts import DronesStart as DronesStart, HitchStart as HitchStart
from hitchopt.motion.flight import Flight as Flight
from hitchopt.motion.motion import Motion as Motion
from hitchopt.objects import Rim as Rim, Section as Section, SolidObject as SolidObject
from hitchopt.plan import Plan as Plan, closest as closest, combine as combine, load as load
from hitchopt.friction.steps import *
from hitchopt.forming.api import form as form
from hitchopt.forming.swap_settings import SwapSettings as SwapSettings
from hitchopt.planners.path import Path as Path
from hitchopt.stages import route as route, time as time
from hitchopt.carrying.steps import *
from hitchopt.repairs.api import repair as repair, suggestions as suggestions
from hitchopt.swarms.api import separate as separate
from hitchopt.steps.moving import *
from hitchopt.forming.steps import *
from hitchopt.swarms.steps import Fly as Fly

__version__: str
__all__: list[str]
PUBLIC_NAMES: dict[str, tuple[str, ...]]
ROOM_NAMES: dict[str, tuple[str, ...]]
