"""The public names: type checkers read them here, and ``__init__.py`` imports them from here."""

from typing import Literal, Self, Unpack

from numpy.typing import ArrayLike

from hitchopt.api import Legs as _Legs, Mission as _Mission, Required as _Required
from hitchopt.api import export as export, repair as repair, separate as separate
from hitchopt.api import solve as solve, suggestions as suggestions
from hitchopt.checks import Certificate as Certificate, CertificateError as CertificateError
from hitchopt.checks import Check as Check, certify as certify
from hitchopt.checks.distances import Closeness as Closeness
from hitchopt.errors import FileError as FileError, HitchoptError as HitchoptError
from hitchopt.errors import InfeasibleError as InfeasibleError, InputError as InputError
from hitchopt.errors import TimeLimitError as TimeLimitError, UnitWarning as UnitWarning
from hitchopt.errors import UnsupportedError as UnsupportedError, Violation as Violation
from hitchopt.exports.lint import lint as lint
from hitchopt.geometry import ConvexArc as ConvexArc, ConvexPolygon as ConvexPolygon
from hitchopt.geometry import regular_polygon as regular_polygon
from hitchopt.hitch import Hitch as Hitch, Quadrotor as Quadrotor, Swarm as Swarm, Team as Team
from hitchopt.hitch.flight_controller import FlightController as FlightController
from hitchopt.hitch.flight_controller import Gains as Gains, Tube as Tube
from hitchopt.hitch.team import Assignment as Assignment
from hitchopt.hitch.catenary import hanging_cable as hanging_cable
from hitchopt.hitch.requirements import Arena as Arena, Limits as Limits, Prism as Prism
from hitchopt.hitch.requirements import Separation as Separation
from hitchopt.hitch.holding import Capacity as Capacity
from hitchopt.hitch.holding import Grip as Grip
from hitchopt.lab.feedback import Feedback as Feedback
from hitchopt.lab.flights.alignment import Alignment as Alignment
from hitchopt.lab.flights.evaluation import Evaluation as Evaluation, evaluate as evaluate
from hitchopt.lab.flights.hover import DroneHover as DroneHover
from hitchopt.lab.flights.hover import HoverCalibration as HoverCalibration
from hitchopt.lab.flights.hover import calibrate_hover as calibrate_hover
from hitchopt.lab.flights.readers import read_flight as read_flight
from hitchopt.lab.flights.recordings import RecordedFlight as RecordedFlight, Recording as Recording
from hitchopt.lab.flights.replay import ReplayedFilter as ReplayedFilter
from hitchopt.lab.flights.replay import replay_filters as replay_filters
from hitchopt.lab.flights.recordings import Signal as Signal, Track as Track
from hitchopt.lab.simulation.report import simulate as simulate
from hitchopt.lab.statics.calibrate import Calibration as Calibration, Estimate as Estimate
from hitchopt.lab.statics.calibrate import calibrate as calibrate
from hitchopt.lab.statics.fit import Fit as Fit, Holding as Holding, fit as fit
from hitchopt.lab.statics.settle import Settled as Settled, settle as settle
from hitchopt.lab.statics.tolerance import ErrorSize as ErrorSize, Tolerance as Tolerance
from hitchopt.lab.statics.tolerance import tolerance as tolerance
from hitchopt.lab.sweeps.study import Study as Study
from hitchopt.lab.sweeps.sweep import SweepError as SweepError
from hitchopt.lab.sweeps.sweep import load_sweep as load_sweep, run_sweep as run_sweep
from hitchopt.live.player import Player as Player, Setpoints as Setpoints
from hitchopt.live.replanner import Replanner as Replanner, Retarget as Retarget
from hitchopt.mission.loading import load_problem as load_problem
from hitchopt.mission.loading import problem_from_dict as problem_from_dict
from hitchopt.mission.others import Other as Other
from hitchopt.mission.problem import DronesStart as DronesStart, HitchStart as HitchStart
from hitchopt.mission.problem import Problem as Problem
from hitchopt.mission.changes import Change as Change
from hitchopt.mission.repair import Suggestion as Suggestion
from hitchopt.mission.solving import forget as forget
from hitchopt.motion.motion import Motion as Motion, Phase as Phase
from hitchopt.motion.states import States as States
from hitchopt.objects import Rim as Rim, Section as Section, SolidObject as SolidObject
from hitchopt.plan import Plan as Plan, closest as closest, combine as combine, load as load
from hitchopt.planners.forming import SwapSettings as SwapSettings
from hitchopt.steps.carrying import Carry as Carry, Enclose as Enclose, Grasp as Grasp
from hitchopt.steps.carrying import Leave as Leave, Lift as Lift, Loosen as Loosen
from hitchopt.steps.carrying import SetDown as SetDown, TransportObject as TransportObject
from hitchopt.steps.moving import Adjust as Adjust, FollowVertex as FollowVertex, Hold as Hold
from hitchopt.steps.moving import Morph as Morph, MoveEdge as MoveEdge, MoveVertex as MoveVertex
from hitchopt.steps.moving import Settle as Settle, Transport as Transport
from hitchopt.steps.straddling import Tie as Tie, Untie as Untie
from hitchopt.steps.tying import CloseVertex as CloseVertex, Form as Form, Land as Land
from hitchopt.steps.tying import OpenVertex as OpenVertex, Release as Release
from hitchopt.steps.flying import Fly as Fly
from hitchopt.trajectory import PiecewisePolynomial as PiecewisePolynomial

from hitchopt.geometry import Outline as _Outline
from hitchopt.steps.carrying import HoldMethod as _By
from hitchopt.steps.tying import Assign as _Assign

_Polygon = _Outline | ArrayLike
_Seconds = float | None
_Settle = float | Literal["auto", False]

__all__: list[str]
__version__: str

class Mission(_Mission):
    """With the methods that ``api.py`` makes of every kind of step."""

    def morph(
        self,
        polygon: _Polygon,
        legs: _Legs | None = None,
        duration: _Seconds = None,
        blend: bool = False,
        optimize: bool = False,
        tension: tuple[float, float] | None = None,
        settle: _Settle = "auto",
    ) -> Self: ...
    def hold(self, seconds: float) -> Self: ...
    def move_vertex(
        self,
        vertex: int,
        to: ArrayLike | None = None,
        by: ArrayLike | None = None,
        legs: _Legs | None = None,
        duration: _Seconds = None,
        blend: bool = False,
        settle: _Settle = "auto",
    ) -> Self: ...
    def move_edge(
        self,
        edge: int,
        to: ArrayLike | None = None,
        by: ArrayLike | None = None,
        legs: _Legs | None = None,
        duration: _Seconds = None,
        blend: bool = False,
        settle: _Settle = "auto",
    ) -> Self: ...
    def adjust(
        self,
        legs: _Legs = "balanced",
        duration: _Seconds = None,
        blend: bool = False,
        settle: _Settle = "auto",
    ) -> Self: ...
    def follow_vertex(
        self,
        vertex: int,
        path: ArrayLike,
        legs: _Legs | None = None,
        speed: float | None = None,
        settle: _Settle = "auto",
    ) -> Self: ...
    def transport(self, to: ArrayLike, yaw: float = 0.0, duration: _Seconds = None) -> Self: ...
    def settle(self, seconds: float | Literal["auto"] = "auto") -> Self: ...
    def form(
        self,
        polygon: _Polygon,
        altitude: float = 1.0,
        legs: _Legs | None = None,
        assign: _Assign = "auto",
        swap: SwapSettings = ...,
        settle: _Settle = "auto",
        by: Literal["swaps", "laying"] = "swaps",
        order: ArrayLike | Literal["auto"] = "auto",
        duration: _Seconds = None,
    ) -> Self: ...
    def open_vertex(self, vertex: int, duration: _Seconds = None) -> Self: ...
    def close_vertex(self, vertex: int, duration: _Seconds = None) -> Self: ...
    def release(self, duration: _Seconds = None) -> Self: ...
    def land(self, duration: _Seconds = None) -> Self: ...
    def enclose(self, object: str, duration: _Seconds = None) -> Self: ...
    def grasp(
        self, object: str, by: _By = "rest", tension: float | None = None, duration: _Seconds = None
    ) -> Self: ...
    def lift(self, by: float, duration: _Seconds = None) -> Self: ...
    def carry(
        self, object: str, to: ArrayLike, yaw: float = 0.0, duration: _Seconds = None
    ) -> Self: ...
    def set_down(self, object: str, duration: _Seconds = None) -> Self: ...
    def loosen(self, object: str, duration: _Seconds = None) -> Self: ...
    def leave(self, object: str, duration: _Seconds = None) -> Self: ...
    def transport_object(
        self,
        object: str,
        to: ArrayLike,
        by: _By | None = None,
        tension: float | None = None,
        yaw: float = 0.0,
        lift: float = 0.3,
        via: ArrayLike | None = None,
    ) -> Self: ...
    def tie(
        self,
        around: str,
        at: float | None = None,
        tension: float | None = None,
        duration: _Seconds = None,
    ) -> Self: ...
    def untie(self, duration: _Seconds = None) -> Self: ...

def morph(
    start: Hitch,
    polygon: _Polygon,
    legs: _Legs | None = None,
    duration: _Seconds = None,
    optimize: bool = False,
    tension: tuple[float, float] | None = None,
    settle: _Settle = "auto",
    **required: Unpack[_Required],
) -> Plan: ...
def hold(start: Hitch, seconds: float, **required: Unpack[_Required]) -> Plan: ...
def move_vertex(
    start: Hitch,
    vertex: int,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    legs: _Legs | None = None,
    duration: _Seconds = None,
    settle: _Settle = "auto",
    **required: Unpack[_Required],
) -> Plan: ...
def move_edge(
    start: Hitch,
    edge: int,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    legs: _Legs | None = None,
    duration: _Seconds = None,
    settle: _Settle = "auto",
    **required: Unpack[_Required],
) -> Plan: ...
def adjust(
    start: Hitch,
    legs: _Legs = "balanced",
    duration: _Seconds = None,
    settle: _Settle = "auto",
    **required: Unpack[_Required],
) -> Plan: ...
def follow_vertex(
    start: Hitch,
    vertex: int,
    path: ArrayLike,
    legs: _Legs | None = None,
    speed: float | None = None,
    settle: _Settle = "auto",
    **required: Unpack[_Required],
) -> Plan: ...
def transport(
    start: Hitch,
    to: ArrayLike,
    yaw: float = 0.0,
    duration: _Seconds = None,
    **required: Unpack[_Required],
) -> Plan: ...
def form(
    team: Team,
    q: ArrayLike,
    r: ArrayLike,
    polygon: _Polygon,
    altitude: float = 1.0,
    legs: _Legs | None = None,
    assign: _Assign = "auto",
    swap: SwapSettings | None = ...,
    settle: _Settle = "auto",
    by: Literal["swaps", "laying"] = "swaps",
    order: ArrayLike | Literal["auto"] = "auto",
    duration: _Seconds = None,
    **required: Unpack[_Required],
) -> Plan: ...
def open_vertex(
    start: Hitch, vertex: int, duration: _Seconds = None, **required: Unpack[_Required]
) -> Plan: ...
def release(start: Hitch, duration: _Seconds = None, **required: Unpack[_Required]) -> Plan: ...
def land(
    team: Team, q: ArrayLike, r: ArrayLike, duration: _Seconds = None, **required: Unpack[_Required]
) -> Plan: ...
