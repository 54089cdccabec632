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
    UnsupportedError as UnsupportedError,
    Violation as Violation,
)
from hitchopt.exports.lint.linting import lint as lint
from hitchopt.geometry import (
    ConvexArc as ConvexArc,
    ConvexPolygon as ConvexPolygon,
    regular_polygon as regular_polygon,
)
from hitchopt.hitch import Hitch as Hitch, Quadrotor as Quadrotor, Swarm as Swarm, Team as Team
from hitchopt.hitch.assignment import Assignment as Assignment
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
from hitchopt.mission.repair import Change as Change, Suggestion as Suggestion
from hitchopt.mission.swarm_problem import SwarmProblem as SwarmProblem
from hitchopt.motion.motion import Motion as Motion, Phase as Phase
from hitchopt.motion.states import States as States
from hitchopt.plan import Plan as Plan, closest as closest, load as load
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
from hitchopt.steps import (
    Adjust as Adjust,
    FollowVertex as FollowVertex,
    Form as Form,
    Hold as Hold,
    Land as Land,
    Morph as Morph,
    MoveEdge as MoveEdge,
    MoveVertex as MoveVertex,
    Release as Release,
    Transport as Transport,
)
from hitchopt.trajectory import PiecewisePolynomial as PiecewisePolynomial

__all__: list[str]
