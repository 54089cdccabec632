"""What does not work with what: every combination that is refused, declared once.

Refusals take their words from ``REFUSALS``, and the documentation its table.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from hitchopt.errors import InputError, UnsupportedError


class Feature(StrEnum):
    """What a user requests: the rows of the table, and the subjects of messages."""

    HOLDING = "holding an object"
    GRIPPING = "gripping an object"
    COST = "a custom cost"
    MOTION = "plan.motion"
    END = "plan.end"
    HOLD_TENSION = "an export with held tension"
    PLAYER = "a player, which slows the clock"
    ABORT = "an abort"
    REPLANNER = "a replanner"
    SURVIVING = "`limits.survive`"
    STATICS = "statics"
    SIMULATION = "simulation"
    SCENE = "a scene for MuJoCo"
    CLASPS = "simulation with `clasps`"
    SIMULATED_LOSS = "the simulated loss of a robot"
    EVALUATE = "evaluate"
    CALIBRATE = "calibrate"


class Neighbour(StrEnum):
    """What else a plan has: the columns of the table."""

    TRACKING = "tracking errors"
    LOADS = "loads"
    FRICTION = "friction"
    WEIGHTLESS = "weightless cables"
    UNEQUAL_TENSIONS = "unequal tensions"
    OTHER_TENSIONS = "tensions other than the team's"
    UNEQUAL_KINDS = "unequal cables or drones"
    CHAINS = "chains"
    FREE_CABLES = "free cables only"
    SINGLE_DRONES = "single drones only"
    SEVERAL_TEAMS = "several teams"
    OTHERS = "`others`"
    OBJECTS = "objects"
    LOOSE_CLASPS = "a start with loose clasps"
    INTEGRAL_GAINS = "integral gains"


class Refusal(NamedTuple):
    """The words of one refusal; names in braces are replaced by what is refused.

    With a ``key`` it is an InputError about that value, and ``reason`` the end of "must be …".
    """

    reason: str
    remedy: str = ""
    key: str = ""

    def __str__(self) -> str:
        return f"{self.reason}; {self.remedy}" if self.remedy else self.reason


_ONE_TEAM = (
    *(Feature.MOTION, Feature.END, Feature.REPLANNER, Feature.STATICS),
    *(Feature.CLASPS, Feature.SIMULATED_LOSS, Feature.EVALUATE, Feature.CALIBRATE),
)
"""Features that support a single team."""

_ALONE = (Feature.REPLANNER, Feature.SIMULATED_LOSS)
"""Those that support no external plans next to it."""

_NO_END = Refusal(
    "a hitch", "form one, or continue with the drones at plan.at(plan.duration)", key="end"
)
_NO_START = Refusal("a hitch, or a plan that ends with one", "form one", key="start")

REFUSALS: Mapping[tuple[Feature, Neighbour], Refusal] = {
    **{
        (feature, Neighbour.SEVERAL_TEAMS): Refusal(
            f"{feature} supports a single team, not {{teams}}",
            "plan that team in a separate file",
        )
        for feature in _ONE_TEAM
    },
    **{
        (feature, Neighbour.OTHERS): Refusal(
            f"{feature} supports a single team, not {{teams}}", "plan it without others"
        )
        for feature in _ALONE
    },
    (Feature.HOLDING, Neighbour.CHAINS): Refusal(
        "closed if objects are held", "close it", key="team.topology"
    ),
    (Feature.GRIPPING, Neighbour.UNEQUAL_KINDS): Refusal(
        "equal for all robots if they grip an object", "use one kind", key="team.{name}"
    ),
    (Feature.COST, Neighbour.CHAINS): Refusal(
        "given for a closed hitch only",
        "omit the cost: routes of chains are not optimised",
        key="cost",
    ),
    (Feature.END, Neighbour.SINGLE_DRONES): _NO_END,
    (Feature.END, Neighbour.FREE_CABLES): _NO_END,
    (Feature.REPLANNER, Neighbour.SINGLE_DRONES): _NO_START,
    (Feature.REPLANNER, Neighbour.FREE_CABLES): _NO_START,
    (Feature.END, Neighbour.OTHER_TENSIONS): Refusal(
        "the plan ends with tensions other than the team's: cannot continue",
        "end it with the team's",
    ),
    (Feature.HOLD_TENSION, Neighbour.SINGLE_DRONES): Refusal(
        "hold_tension=True: single drones have no cables", "omit it"
    ),
    (Feature.HOLD_TENSION, Neighbour.INTEGRAL_GAINS): Refusal(
        "0 with hold_tension=True: integral gains would pull drones to the moved setpoints",
        "set team.quadrotor.gains.ki to 0, in the problem and on the drones",
        key="gains.ki",
    ),
    (Feature.PLAYER, Neighbour.OTHERS): Refusal(
        "{other} flies on a clock that cannot be slowed",
        "plan without others, or use aborts only",
    ),
    (Feature.SURVIVING, Neighbour.OBJECTS): Refusal(
        "omitted with objects: those that are held fall, as all cables are loose until they are a "
        "chain, and distances of others from what falls and swings are not bounded",
        "plan without objects",
        key="limits.survive",
    ),
    (Feature.STATICS, Neighbour.SINGLE_DRONES): Refusal(
        "a plan of single drones has no cables", "use a hitch's plan"
    ),
    (Feature.STATICS, Neighbour.FREE_CABLES): Refusal(
        "a plan without a taut hitch has no tensions", "form one in it"
    ),
    (Feature.STATICS, Neighbour.OBJECTS): Refusal(
        "statics do not model objects that a hitch carries", "choose a time without them"
    ),
    (Feature.SCENE, Neighbour.LOADS): Refusal(
        "a scene for MuJoCo does not support loads, which are not bodies", "simulate the plan"
    ),
    (Feature.CLASPS, Neighbour.OBJECTS): Refusal(
        "cables that slide through clasps meet no objects", "simulate ropes"
    ),
    (Feature.SIMULATION, Neighbour.LOOSE_CLASPS): Refusal(
        "simulation does not support plans that begin with loose clasps, as after the loss of a "
        "robot",
        "simulate the plan before it",
    ),
    (Feature.SIMULATION, Neighbour.SINGLE_DRONES): Refusal(
        "single drones have no cables", "simulate a hitch's plan"
    ),
}
"""Every refused combination; all others are supported."""


def unsupported(
    feature: Feature, neighbour: Neighbour, when: str = "", **refused: str
) -> UnsupportedError:
    """Return the error that refuses a combination, from ``when`` on: a step or a time."""
    words = str(REFUSALS[feature, neighbour]).format(**refused)
    return UnsupportedError(f"{when}: {words}" if when else words)


def refused_value(
    feature: Feature,
    neighbour: Neighbour,
    value: object,
    kind: type[InputError] = InputError,
    **refused: str,
) -> InputError:
    """Return the error about the value of a key by which a combination is refused."""
    reason, remedy, key = REFUSALS[feature, neighbour]
    return kind(key.format(**refused), value, reason, remedy)
