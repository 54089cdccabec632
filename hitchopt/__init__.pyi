"""The public names of ``__init__.py``, for type checkers and editors."""

from hitchopt.api import Mission as Mission, export as export, repair as repair
from hitchopt.api import separate as separate, solve as solve, suggestions as suggestions
from hitchopt.checks import Certificate as Certificate, CertificateError as CertificateError
from hitchopt.checks import Check as Check, certify as certify
from hitchopt.checks.custom import ClaspSpans as ClaspSpans, DroneSpans as DroneSpans
from hitchopt.checks.custom import Rule as Rule, VertexSpans as VertexSpans
from hitchopt.checks.distances import Closeness as Closeness
from hitchopt.errors import FileError as FileError, HitchoptError as HitchoptError
from hitchopt.errors import InfeasibleError as InfeasibleError, InputError as InputError
from hitchopt.errors import TimeLimitError as TimeLimitError, UnitWarning as UnitWarning
from hitchopt.errors import UnsupportedError as UnsupportedError, Violation as Violation
from hitchopt.exports.lint import lint as lint
from hitchopt.geometry import ConvexArc as ConvexArc, ConvexPolygon as ConvexPolygon
from hitchopt.geometry import regular_polygon as regular_polygon
from hitchopt.hitch import Hitch as Hitch, Quadrotor as Quadrotor, Swarm as Swarm, Team as Team
from hitchopt.hitch.casadi_model import model as model
from hitchopt.hitch.catenary import hanging_cable as hanging_cable
from hitchopt.hitch.flight_controller import FlightController as FlightController
from hitchopt.hitch.flight_controller import Gains as Gains, Tube as Tube
from hitchopt.hitch.holding import Capacity as Capacity, Grip as Grip
from hitchopt.hitch.requirements import Arena as Arena, Limits as Limits, Prism as Prism
from hitchopt.hitch.requirements import Separation as Separation
from hitchopt.hitch.team import Assignment as Assignment
from hitchopt.lab.feedback import Feedback as Feedback
from hitchopt.lab.flights.alignment import Alignment as Alignment
from hitchopt.lab.flights.evaluation import Evaluation as Evaluation, evaluate as evaluate
from hitchopt.lab.flights.hover import DroneHover as DroneHover
from hitchopt.lab.flights.hover import HoverCalibration as HoverCalibration
from hitchopt.lab.flights.hover import calibrate_hover as calibrate_hover
from hitchopt.lab.flights.readers import read_flight as read_flight
from hitchopt.lab.flights.recordings import RecordedFlight as RecordedFlight
from hitchopt.lab.flights.recordings import Recording as Recording, Signal as Signal
from hitchopt.lab.flights.recordings import Track as Track
from hitchopt.lab.simulation.report import simulate as simulate
from hitchopt.lab.statics.calibrate import Calibration as Calibration, Estimate as Estimate
from hitchopt.lab.statics.calibrate import calibrate as calibrate
from hitchopt.lab.statics.fit import Fit as Fit, Holding as Holding, fit as fit
from hitchopt.lab.statics.equilibrium import Equilibrium as Equilibrium
from hitchopt.lab.statics.equilibrium import equilibrium as equilibrium
from hitchopt.lab.statics.tolerance import ErrorSize as ErrorSize, Tolerance as Tolerance
from hitchopt.lab.statics.tolerance import tolerance as tolerance
from hitchopt.lab.sweeps.study import Study as Study
from hitchopt.lab.sweeps.sweep import SweepError as SweepError, load_sweep as load_sweep
from hitchopt.lab.sweeps.sweep import run_sweep as run_sweep
from hitchopt.live.player import Player as Player, Setpoints as Setpoints
from hitchopt.live.replanner import Replanner as Replanner, Retarget as Retarget
from hitchopt.mission.changes import Change as Change
from hitchopt.mission.loading import load_problem as load_problem
from hitchopt.mission.loading import problem_from_dict as problem_from_dict
from hitchopt.mission.others import Other as Other
from hitchopt.mission.problem import DronesStart as DronesStart, HitchStart as HitchStart
from hitchopt.mission.problem import Problem as Problem
from hitchopt.mission.repair import Suggestion as Suggestion
from hitchopt.mission.solving import forget as forget
from hitchopt.motion.flight import Flight as Flight
from hitchopt.motion.flight import TeamMotion as TeamMotion
from hitchopt.motion.motion import Motion as Motion, Phase as Phase
from hitchopt.motion.states import States as States
from hitchopt.objects import Rim as Rim, Section as Section, SolidObject as SolidObject
from hitchopt.plan import Plan as Plan, closest as closest, combine as combine, load as load
from hitchopt.planners.forming import SwapSettings as SwapSettings
from hitchopt.planners.morph.path import Path as Path
from hitchopt.single_steps import adjust as adjust, follow_vertex as follow_vertex, form as form
from hitchopt.single_steps import hold as hold, land as land, morph as morph
from hitchopt.single_steps import move_edge as move_edge, move_vertex as move_vertex
from hitchopt.single_steps import open_vertex as open_vertex, release as release
from hitchopt.single_steps import settle as settle, transport as transport
from hitchopt.stages import route as route, time as time
from hitchopt.steps.carrying import Carry as Carry, Enclose as Enclose, Grasp as Grasp
from hitchopt.steps.carrying import Leave as Leave, Lift as Lift, Loosen as Loosen
from hitchopt.steps.carrying import SetDown as SetDown, TransportObject as TransportObject
from hitchopt.steps.flying import Fly as Fly
from hitchopt.steps.moving import Adjust as Adjust, FollowVertex as FollowVertex, Hold as Hold
from hitchopt.steps.moving import Morph as Morph, MoveEdge as MoveEdge, MoveVertex as MoveVertex
from hitchopt.steps.moving import Settle as Settle, Transport as Transport
from hitchopt.steps.straddling import Tie as Tie, Untie as Untie
from hitchopt.steps.tying import CloseVertex as CloseVertex, Form as Form, Land as Land
from hitchopt.steps.tying import OpenVertex as OpenVertex, Release as Release
from hitchopt.trajectory import PiecewisePolynomial as PiecewisePolynomial

__version__: str
__all__: list[str]
