"""The public names: type checkers read them here, and ``__init__.py`` imports them from here."""

from hitchopt.actions import (
    adjust as adjust,
    follow_vertex as follow_vertex,
    form as form,
    hold as hold,
    land as land,
    morph as morph,
    move_edge as move_edge,
    move_vertex as move_vertex,
    release as release,
    transport as transport,
)
from hitchopt.builder import Mission as Mission
from hitchopt.calibration.calibrate import (
    Calibration as Calibration,
    calibrate as calibrate,
)
from hitchopt.calibration.estimates import Estimate as Estimate
from hitchopt.calibration.recordings import Recording as Recording
from hitchopt.checks import (
    Certificate as Certificate,
    CertificateError as CertificateError,
    Check as Check,
    certify as certify,
)
from hitchopt.checks.bounds.closest_pairs import Closeness as Closeness
from hitchopt.errors import (
    FileError as FileError,
    HitchoptError as HitchoptError,
    InfeasibleError as InfeasibleError,
    InputError as InputError,
    TimeLimitError as TimeLimitError,
    UnitWarning as UnitWarning,
    UnsupportedError as UnsupportedError,
    Violation as Violation,
)
from hitchopt.exports.lint.linting import lint as lint
from hitchopt.feedback.feedback import Feedback as Feedback
from hitchopt.fitting.fit import Fit as Fit, Holding as Holding, fit as fit
from hitchopt.geometry import (
    ConvexArc as ConvexArc,
    ConvexPolygon as ConvexPolygon,
    regular_polygon as regular_polygon,
)
from hitchopt.hitch import Hitch as Hitch, Quadrotor as Quadrotor, Swarm as Swarm, Team as Team
from hitchopt.hitch.assignment import Assignment as Assignment
from hitchopt.hitch.hanging_cable import hanging_cable as hanging_cable
from hitchopt.holding.capacity import Capacity as Capacity
from hitchopt.holding.grip_statics import Grip as Grip
from hitchopt.mission.loading import (
    load_problem as load_problem,
    load_swarm as load_swarm,
    problem_from_dict as problem_from_dict,
    read_problem as read_problem,
)
from hitchopt.mission.memory import forget as forget
from hitchopt.mission.problem import (
    DronesStart as DronesStart,
    HitchStart as HitchStart,
    Problem as Problem,
)
from hitchopt.mission.repair.change import Change as Change, Suggestion as Suggestion
from hitchopt.mission.swarm_problem import SwarmProblem as SwarmProblem
from hitchopt.motion.motion import Motion as Motion, Phase as Phase
from hitchopt.motion.states import States as States
from hitchopt.objects import Rim as Rim, Section as Section, SolidObject as SolidObject
from hitchopt.plan import Plan as Plan, closest as closest, load as load
from hitchopt.plan_uses import export as export, simulate as simulate
from hitchopt.planners.forming.turns import SwapSettings as SwapSettings
from hitchopt.planning import (
    repair as repair,
    separate as separate,
    solve as solve,
    suggestions as suggestions,
)
from hitchopt.requirements import (
    Arena as Arena,
    Limits as Limits,
    Prism as Prism,
    Separation as Separation,
)
from hitchopt.settling.error_sizes import ErrorSize as ErrorSize
from hitchopt.settling.settle import settle as settle
from hitchopt.settling.settled_hitch import Settled as Settled
from hitchopt.settling.tolerance import (
    Tolerance as Tolerance,
    tolerance as tolerance,
)
from hitchopt.steering.replanner import Replanner as Replanner
from hitchopt.steering.retarget import Retarget as Retarget
from hitchopt.steps import (
    Adjust as Adjust,
    Carry as Carry,
    Enclose as Enclose,
    FollowVertex as FollowVertex,
    Form as Form,
    Grasp as Grasp,
    Hold as Hold,
    Land as Land,
    Leave as Leave,
    Lift as Lift,
    Loosen as Loosen,
    Morph as Morph,
    MoveEdge as MoveEdge,
    MoveVertex as MoveVertex,
    Release as Release,
    SetDown as SetDown,
    Transport as Transport,
    TransportObject as TransportObject,
)
from hitchopt.stopping.player import Player as Player
from hitchopt.stopping.sampler import Setpoints as Setpoints
from hitchopt.sweeps.cluster import SweepError as SweepError
from hitchopt.sweeps.dataset import load_sweep as load_sweep
from hitchopt.sweeps.running import run_sweep as run_sweep
from hitchopt.sweeps.study import Study as Study
from hitchopt.trajectory import PiecewisePolynomial as PiecewisePolynomial

__all__: list[str]
__version__: str
