"""The public names: type checkers read them here, and ``__init__.py`` imports them from here."""

from hitchopt.actions import (
    adjust as adjust,
    follow_vertex as follow_vertex,
    hold as hold,
    morph as morph,
    move_edge as move_edge,
    move_vertex as move_vertex,
    transport as transport,
)
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
from hitchopt.hitch import (
    Hitch as Hitch,
    Quadrotor as Quadrotor,
    Swarm as Swarm,
    Team as Team,
)
from hitchopt.hitch.assignment import Assignment as Assignment
from hitchopt.mission.loading import (
    load_problem as load_problem,
    load_swarm as load_swarm,
    read_problem as read_problem,
)
from hitchopt.mission.memory import forget as forget
from hitchopt.mission.problem import (
    Adjust as Adjust,
    DronesStart as DronesStart,
    FollowVertex as FollowVertex,
    Form as Form,
    HitchStart as HitchStart,
    Hold as Hold,
    Land as Land,
    Morph as Morph,
    MoveEdge as MoveEdge,
    MoveVertex as MoveVertex,
    Problem as Problem,
    Release as Release,
    SwapSettings as SwapSettings,
    Transport as Transport,
)
from hitchopt.mission.repair import (
    Change as Change,
    Suggestion as Suggestion,
)
from hitchopt.mission.swarm import SwarmProblem as SwarmProblem
from hitchopt.motion.motion import (
    Motion as Motion,
    Phase as Phase,
)
from hitchopt.motion.states import States as States
from hitchopt.plan import (
    Plan as Plan,
    closest as closest,
    load as load,
)
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
from hitchopt.trajectory import PiecewisePolynomial as PiecewisePolynomial
from hitchopt.tying import (
    form as form,
    land as land,
    release as release,
)

__all__: list[str]
