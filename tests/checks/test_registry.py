"""One rule per check, and what a certificate says where nothing was counted."""

from __future__ import annotations

import json
import math

import pytest
from free_cases import free_motion, random_flight
from open_chain_cases import random_chain

from hitchopt.checks import Certificate, CertificateError, Check, certify
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import HITCHED_STATE, CableState, Motion

HITCHED, FREE = CableState.HITCHED, CableState.FREE


def test_a_new_rule_needs_only_a_finder() -> None:
    """The worst of a rule is that of all spans in its states, held against its limit."""
    looked_at: list[tuple[float, float]] = []

    def find(motion: Motion, limit: float) -> Finding:
        looked_at.append((float(motion.drones.breaks[0]), limit))
        return Finding(float(motion.drones.breaks[0]), 1.0, ("q0",))

    team, drones = random_flight(2, pieces=5)
    motion = free_motion(team, drones, *(HITCHED, FREE, HITCHED, HITCHED, FREE))
    rule = CheckRule("start", "s", "max", 1e-3, (Finder(find, HITCHED_STATE),))
    check = rule.check(motion)
    assert looked_at == [(drones.breaks[0], 1e-3), (drones.breaks[2], 1e-3)]
    assert check is not None
    assert (check.worst, check.holds, check.where) == (drones.breaks[2], False, ("q0",))
    assert rule.check(free_motion(team, drones)) is None
    assert rule.check(motion, exported=True) is None


def test_where_nothing_was_counted_worst_is_null() -> None:
    """All parts of a chain of two cables share its one clasp: no two of them may cross."""
    certificate = certify(random_chain(2, 0))
    check = certificate["crossing"]
    assert check.worst is None
    assert check.holds
    assert check.where == ()
    assert check.bound == math.inf
    text = json.dumps(certificate.to_dict(), allow_nan=False)
    told = {entry["name"]: entry["worst"] for entry in json.loads(text)["checks"]}
    assert told["crossing"] is None
    assert sum(worst is None for worst in told.values()) == 1
    assert certify(random_chain(3, 0))["crossing"].worst is not None


@pytest.mark.parametrize("sense", ["min", "max"])
def test_only_an_infinity_that_holds_is_nothing(sense: str) -> None:
    good = math.inf if sense == "min" else -math.inf
    nothing = Check.of("x", good, 1.0, sense, "m", 2.0, ("q0",))
    assert (nothing.worst, nothing.holds, nothing.where) == (None, True, ())
    for bad in (-good, math.nan):
        check = Check.of("x", bad, 1.0, sense, "m", 2.0, ("q0",))
        assert not check.holds
        assert check.worst is not None
        assert math.isfinite(check.worst)
        assert check.where == ("q0",)
        with pytest.raises(CertificateError, match="q0"):
            Certificate(1.0, (check,)).raise_if_violated()
    some = Check.of("x", 3.0, 3.0, sense, "m", 0.0, ())
    assert max((nothing, some), key=lambda each: each.pressure) is some
