"""Cables are in the states that phases state: polynomials say so, names and flags do not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hitchopt import verify as second
from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import RULES
from hitchopt.hitch import Team
from hitchopt.motion.cable_state import STATES, CableState
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import cut, padded
from hitchopt.verify import consistency
from tests.helpers.motions import altered, free_motion, plus, row, through
from tests.helpers.plans import planned

TYING = ("tie_carry_untie", "form_triangle")
CABLES = tuple(state for state in STATES if state.has_cables)
VERTICES = {"p0", "p1", "p2"}
ALL = {"cable 0", "cable 1", "cable 2"}


@cache
def certificate_of(name: str) -> Certificate:
    return certify(planned(name).motion)


def merged(motion: Motion, first: int, last: int, state: CableState) -> Motion:
    """Return phases ``first`` to ``last`` merged into one, in a state."""
    phases = motion.phases
    one = replace(phases[first], end=phases[last].end, state=state)
    return replace(motion, phases=(*phases[:first], one, *phases[last + 1 :]))


def refused(motion: Motion) -> set[str]:
    """Assert that ``interlacing`` fails, with phase and time."""
    check = row(motion, "interlacing")
    assert not check.holds
    first, *where = check.where
    phase = motion.phases[int(first.split()[1])]
    assert first == f"phase {motion.phases.index(phase)} ({phase.name})"
    assert phase.start - 1e-6 <= check.time <= phase.end + 1e-6
    return set(where)


def index_of(motion: Motion, name: str) -> int:
    return [phase.name for phase in motion.phases].index(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", TYING)
def test_phase_names_have_no_effect(name: str) -> None:
    motion = planned(name).motion
    for names in (["take-off"], ["hold", "swap 1", "parked", "tighten"]):
        phases = [replace(p, name=names[i % len(names)]) for i, p in enumerate(motion.phases)]
        renamed = replace(motion, phases=tuple(phases))
        assert certify(renamed).to_dict() == certificate_of(name).to_dict()


@pytest.mark.slow
@pytest.mark.parametrize("name", TYING)
def test_every_other_state_fails(name: str) -> None:
    motion = planned(name).motion
    assert certificate_of(name).certified
    rules = sorted(RULES, key=lambda rule: rule.name != "interlacing")  # one that fails is enough
    for i, phase in enumerate(motion.phases):
        for state in set(CABLES) - {phase.state}:
            checks = (rule.check(merged(motion, i, i, state)) for rule in rules)
            assert any(check and not check.holds for check in checks), (phase.name, state)


@pytest.mark.parametrize(
    ("first", "state"),
    [
        ("approach", CableState.CLASPING),  # the time before a swap is not clasping
        ("swap 1", CableState.CLASPING),  # nor what follows: else nothing sees torn cables
        ("swap 1", CableState.TIGHTENING),
        ("swap 1", CableState.LOOSE),  # a plan begins with a loss
    ],
)
def test_phases_do_not_cover_their_neighbours(first: str, state: CableState) -> None:
    motion = planned("tie_carry_untie").motion
    index = index_of(motion, first)
    assert motion.phases[index_of(motion, "swap 1") + 2].name == "tighten"
    assert refused(merged(motion, index, index + 2, state)) >= VERTICES


@pytest.mark.slow
def test_cables_at_full_length_are_not_being_tightened() -> None:
    """This holds for any legs, tensions and positions of clasps."""
    motion = planned("tie_carry_untie").motion
    first, last = (index_of(motion, name) for name in ("tighten", "loosen"))
    whole = merged(motion, first, last, CableState.TIGHTENING)
    changed = altered(altered(whole, "legs", np.zeros_like), "tensions", np.zeros_like)
    moved = altered(changed, "vertices", plus((slice(None), 0, 0), 0.02))
    for each in (whole, changed, moved):
        assert refused(each) == ALL


@pytest.mark.parametrize("state", ["tighten", "loosen"])
@pytest.mark.parametrize("follow", [False, True])
def test_clasps_go_straight_while_cables_are_tightened(
    state: str, follow: bool, tmp_path: Path
) -> None:
    """None wanders by 5 cm and back, although no cable is taut that it could pull."""
    motion = planned("tie_carry_untie").motion
    pieces = np.flatnonzero(motion.phase_of_piece == index_of(motion, state))
    assert len(pieces) > 1
    bump = np.zeros(motion.vertices.coefficients.shape)
    bump[pieces[0], 0, 0, 3:] = bump[pieces[1], 0, 0, :-3] = 0.05
    wandering = motion.vertices.replaced(motion.vertices.coefficients + bump)
    flown = motion.replaced(vertices=wandering)
    if not follow:
        flown = flown.replaced(contacts=motion.contacts)
    assert refused(flown) == ALL
    assert "grip" not in {check.name for check in certify(flown, reports=()).violated}
    write_plan(tmp_path / "plan.npz", Flight.of(flown))
    (plan,), _ = second.read(tmp_path / "plan.npz")
    faults = {text for _, applies, text in consistency.clasp_faults(plan) if applies}
    assert faults == {"clasps wander while cables are tightened"}


def test_clasps_end_where_the_hitch_has_them(tmp_path: Path) -> None:
    """They go straight, but elsewhere."""
    motion = planned("tie_carry_untie").motion
    pieces = motion.phase_of_piece == index_of(motion, "tighten")
    beside = altered(motion, "vertices", plus((pieces, 0, 0), 0.02))
    assert row(motion, "continuity").holds
    assert not row(beside, "continuity").holds
    worst = list[float]()
    for each in (motion, beside):
        write_plan(tmp_path / "plan.npz", Flight.of(each))
        (plan,), _ = second.read(tmp_path / "plan.npz")
        worst.append(max(value for (value, *_), _ in consistency.curve_jumps(plan)))
    assert worst[0] < 1e-6 < worst[1]


@pytest.mark.slow
def test_cables_hang_free_while_drones_rest_after_they_are_unclasped() -> None:
    motion = planned("tie_carry_untie").motion
    states = [phase.state for phase in motion.phases]
    last = len(states) - 1 - states[::-1].index(CableState.CLASPING)
    begin = len(states) - 1 - states[::-1].index(CableState.HITCHED)
    ends = np.array([motion.phases[begin].start, motion.phases[last].end])
    nearest = np.argmin(np.abs(motion.drones.breaks - ends[:, None]), axis=1)
    released = cut(motion, *nearest.tolist())
    whole = padded(released, 0.0, released.duration + 2.0)
    assert whole.phases[-1].state == CableState.FREE
    assert certify(whole).certified


def test_drones_with_cables_on_the_ground_do_not_fly_sideways() -> None:
    assert refused(merged(planned("form_triangle").motion, 0, 1, CableState.GROUND)) == ALL


@pytest.mark.parametrize(
    ("height", "state"),
    [(0.0, CableState.GROUND), (0.3, CableState.GROUND), (2.0, CableState.FREE)],
)
def test_cables_on_the_ground_reach_it(height: float, state: CableState) -> None:
    """Cables at rest that are too close to the ground to hang lie on it."""
    places = np.array([[x, y, height] for y in (0.0, 1.0, 2.0) for x in (4.0, 5.0)])
    drones = through([0.0, 1.0], [places, places])
    for each in (CableState.GROUND, CableState.FREE):
        assert certify(free_motion(Team(3, 1.5), drones, each)).certified is (each is state)


def test_a_clasp_turns_about_a_point_at_rest() -> None:
    """Swaps with pairs that drift by two millimetres as they turn."""
    motion = planned("form_triangle").motion
    pieces = np.flatnonzero(motion.phase_of_piece == index_of(motion, "swap 1"))
    layout, bump = motion.team.layout, np.zeros(motion.drones.degree + 1)
    bump[3:-3] = 0.02
    pair = [2 * layout.ahead[1], 2 * layout.behind[1] + 1]
    where = (pieces[len(pieces) // 2], pair, 0)
    assert refused(altered(motion, "drones", plus(where, bump))) == {f"p{layout.clasps[1]}"}


@pytest.mark.parametrize(("part", "phase"), [("legs", "tighten"), ("tensions", "swap 2")])
def test_no_leg_and_no_tension_without_a_hitch(part: str, phase: str) -> None:
    motion = planned("form_triangle").motion
    first = int(np.argmax(motion.phase_of_piece == index_of(motion, phase)))
    changed = altered(motion, part, plus((first, 1), 0.1))
    assert refused(changed) == {motion.team.cable_names[1]}
    assert row(changed, "interlacing").where[0].endswith(f"({phase})")


@pytest.mark.slow
def test_phases_may_end_within_pieces() -> None:
    """A piece belongs to the phase of its middle: phases of blended steps end within pieces."""
    motion = planned("tie_carry_untie").motion
    phases = list(motion.phases)
    i = next(i for i, p in enumerate(phases) if p.state == phases[i + 1].state)
    phases[i] = replace(phases[i], end=phases[i].end + 1e-3)
    phases[i + 1] = replace(phases[i + 1], start=phases[i].end)
    blended = certify(replace(motion, phases=tuple(phases)))
    assert blended.to_dict() == certificate_of("tie_carry_untie").to_dict()
