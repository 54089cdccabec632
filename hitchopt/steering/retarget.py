"""The answer to a new goal: a plan that leaves the present one, certified from there on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.bounds.shared_values import shared_values
from hitchopt.checks.certificate import Check
from hitchopt.checks.equilibrium import QUICK
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.rule import Findings, Found
from hitchopt.checks.stops import RULE as STOPPABLE
from hitchopt.checks.tracking_radius import GAMMA
from hitchopt.errors import InfeasibleError
from hitchopt.motion.cutting import cut
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import beside_objects, followed
from hitchopt.one_line import OneLine
from hitchopt.plan import Plan
from hitchopt.requirements import Requirements
from hitchopt.steering.retarget_path import RetargetPath
from hitchopt.steering.retarget_timing import shortest_shift, turning_slowly
from hitchopt.steps.certified_motions import flying, infeasible
from hitchopt.values import Array

IN_FLIGHT = (STOPPABLE,)
"""Reports on certified answers while the hitch flies; all others are of the whole plan."""

PIECE = 0.3
"""[s] Length of the pieces of the brake, which is as quick as limits allow."""

PIECES = 10
"""Number of pieces that a shift is divided into where they are no shorter than those of the brake:
a cable's length is then right within 1e-6 of it."""

FEWEST = 4
"""Least number of pieces of a retarget."""

ROUNDS = 3
"""Certificates that are tried for one goal, each after a change for what the last one said."""

SLOWER = {
    "speed": 1,
    "vertex_speed": 1,
    "acceleration": 2,
    "jerk": 3,
    "thrust": 2,
    "tilt": 2,
    "body_rate": 1,
}
"""Checks that a longer shift eases, and the power of the duration with which they fall, at least.
"""

DISTANCES = ("separation", "cable_clearance", "crossing")
"""Checks of what neither eases: another path is tried where one is broken."""

FIRST = (*DISTANCES, *SLOWER)
"""Checks that are looked at first, distances before all: where one is broken, others may wait."""

BRAKES = 3
"""Brakes that are tried, from the shortest on, where limits of motion are broken."""

STRETCH = 1.02
"""Least factor by which a shift is prolonged then."""

FINER = frozenset({"cable_length", "equilibrium", "tension"})
"""Checks that shorter pieces ease."""


@dataclass(frozen=True, eq=False)
class Retarget(OneLine):
    """Answer of a replanner.

    Attributes
    ----------
    accepted: whether the hitch flies to the new goal; if not, all goes on as before.
    start: time at which the new plan leaves the old one [s].
    motion: what flies now, from the beginning of steering.
    ahead: the part from the last break before ``start`` on, t = 0 there; of a refusal the motion.
    certificate: of ``ahead``, all checks but those that need no limit and most time.
    reason: of a refusal, in words.
    """

    accepted: bool
    start: float
    motion: Motion
    ahead: Motion
    certificate: Certificate
    reason: str = ""

    def _parts(self) -> Iterator[str]:
        yield "accepted" if self.accepted else f"refused: {self.reason}"
        yield f"from t = {self.start:.4g} s, until {self.motion.duration:.4g} s"

    @cached_property
    def plan(self) -> Plan:
        """The whole plan, the old one until ``start``, with a full certificate of its own."""
        return Plan(self.motion, certify(self.motion), "Steered")


class NotNowError(Exception):
    """A retarget cannot begin at this time."""


@dataclass(frozen=True, eq=False)
class Refusal:
    """What keeps a path from being certified.

    Attributes
    ----------
    error: what was found first.
    ahead: the motion that it is of; None where there is none.
    known: what rules have found on it.
    """

    error: InfeasibleError
    ahead: Motion | None = None
    known: Findings = field(default_factory=dict)

    def complete(self) -> InfeasibleError:
        """Return all that keeps it."""
        if self.ahead is None or any(v.constraint not in FIRST for v in self.error.violations):
            return self.error
        certificate = certify(self.ahead.untimed, reports=(), known=self.known)
        return infeasible(certificate, self.ahead)


def braked_retarget(
    past: Motion, path: RetargetPath, durations: Sequence[float], requirements: Requirements
) -> Retarget | Refusal:
    """Return the answer for a path, or the first refusal.

    Parameters
    ----------
    durations: of the brakes that are tried [s], at least one.
    """
    first: Refusal | None = None
    for brake in durations:
        found = certified_retarget(past, path, brake, requirements)
        if isinstance(found, Retarget):
            return found
        first = first or found
        if not {each.constraint for each in found.error.violations} <= SLOWER.keys():
            break
    assert first is not None
    return first


def certified_retarget(
    past: Motion, path: RetargetPath, brake: float, requirements: Requirements
) -> Retarget | Refusal:
    """Return the answer for a path, or what keeps it from being certified.

    Parameters
    ----------
    past: the present plan until it is left.
    path: from its end.
    brake: duration of the brake [s].
    requirements: what the plan must satisfy.
    """
    shift = shortest_shift(path, turning_slowly(requirements.planned.limits), brake)
    if shift is None:
        why = "no duration keeps all limits on the way to the goal"
        return Refusal(InfeasibleError([], why))
    finer, first = 1.0, None
    recent = cut(past, past.drones.pieces - 1, past.drones.pieces)
    for _ in range(ROUNDS):
        phase = Phase("retarget", past.phases[-1].step + 1, 0.0, max(brake, shift))
        flight = path.flight(_breaks(brake, shift, finer, moving=path.state.moves), brake, shift)
        fresh = beside_objects(past, flying(flight, path.team, requirements, [phase]))
        ahead = followed(recent, fresh)
        checked = ahead.untimed
        with shared_values():
            known, short = _looked_at(checked)
            if short:
                certificate = Certificate(ahead.duration, short)
            else:
                known = {**known, QUICK.name: QUICK.findings(checked)}
                certificate = certify(checked, reports=(), known=known)
            if certificate.certified:
                stops = tuple(report.check(checked, {}, GAMMA) for report in IN_FLIGHT)
                certificate = replace(certificate, checks=(*certificate.checks, *stops))
        if certificate.certified:
            motion = followed(past, fresh)
            return Retarget(True, past.duration, motion, ahead, certificate)
        broken = {check.name: check for check in certificate.violated}
        refusal = Refusal(infeasible(certificate, ahead), ahead, known)
        if not broken.keys() <= SLOWER.keys() | FINER:
            return refusal
        first = first or refusal
        if any(check.time <= recent.duration + brake for check in certificate.violated):
            return first  # a longer shift does not change the brake
        ratios = [
            (broken[name].bound / broken[name].number) ** (1.0 / power)
            for name, power in SLOWER.items()
            if name in broken
        ]
        shift *= max([STRETCH * ratio for ratio in ratios], default=1.0)
        finer *= 0.5 if broken.keys() & FINER else 1.0
    assert first is not None
    return first


def _looked_at(motion: Motion) -> tuple[Findings, tuple[Check, ...]]:
    """Return what the rules that are looked at FIRST find, and the checks that do not hold.

    Up to the first kind of which some do not.
    """
    known: dict[str, Sequence[Found]] = {}
    short: list[Check] = []
    for names in (DISTANCES, SLOWER):
        for name in names:
            known[name] = RULE_OF[name].findings(motion)
            short += [each.check for each in known[name] if not each.check.holds]
        if short:
            break
    return known, tuple(short)


def _breaks(brake: float, shift: float, finer: float, *, moving: bool) -> Array:
    """Return the breaks of a retarget: its end, the brake's and the shift's, and more.

    Parameters
    ----------
    brake, shift: durations [s].
    finer: factor of the pieces' lengths.
    moving: whether there is a brake.
    """
    edges = sorted({0.0, brake, shift}) if moving else [0.0, shift]
    least = min(PIECE, edges[-1] / FEWEST)
    parts = [np.zeros(1)]
    for start, end in pairwise(edges):
        braking = moving and end <= brake
        piece = finer * (least if braking else max(least, shift / PIECES))
        count = math.ceil((end - start) / piece * (1.0 - 1e-9))
        parts.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(parts)
