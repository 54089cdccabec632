"""Cables are in the states that phases state: polynomials say so, names and flags do not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from free_cases import free_motion, through
from plans import planned

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import RULES
from hitchopt.checks.spans import phase_parts
from hitchopt.checks.story import INTERLACING, chord_crossings
from hitchopt.hitch import Team
from hitchopt.motion.motion import CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial

TYING = ("tie_carry_untie", "form_triangle")
CABLES = tuple(state for state in CableState if state is not CableState.NONE)


@cache
def certificate_of(name: str) -> Certificate:
    return certify(planned(name).motion)


def renamed(motion: Motion, names: list[str]) -> Motion:
    phases = (replace(p, name=names[i % len(names)]) for i, p in enumerate(motion.phases))
    return replace(motion, phases=tuple(phases))


def claimed(motion: Motion, i: int, state: CableState) -> Motion:
    """Phase i in another state."""
    phases = motion.phases
    return replace(motion, phases=(*phases[:i], replace(phases[i], state=state), *phases[i + 1 :]))


@pytest.mark.slow
def test_phases_may_end_within_pieces() -> None:
    """A piece counts to the phase of its middle, as phases of blended steps end where they do."""
    motion = planned("tie_carry_untie").motion
    phases = list(motion.phases)
    i = next(i for i, p in enumerate(phases) if p.state is phases[i + 1].state)
    joint = phases[i].end
    phases[i] = replace(phases[i], end=joint + 1e-3)
    phases[i + 1] = replace(phases[i + 1], start=joint + 1e-3)
    parts = list(phase_parts(replace(motion, phases=tuple(phases))))
    assert [part.phase for part in parts] == phases
    ends = [parts[i].motion.drones.breaks[-1], parts[i + 1].motion.drones.breaks[0]]
    assert ends == [joint, joint]


def merged(motion: Motion, first: int, last: int, state: CableState) -> Motion:
    """Phases ``first`` to ``last`` as one in some state."""
    phases = motion.phases
    one = replace(phases[first], end=phases[last].end, state=state)
    return replace(motion, phases=(*phases[:first], one, *phases[last + 1 :]))


def slackened(motion: Motion) -> Motion:
    """Neither legs nor tensions anywhere, so that these do not tell of a hitch."""
    breaks, n = motion.drones.breaks, motion.team.robots
    constant = PiecewisePolynomial.constant
    return replace(
        motion, legs=constant(breaks, np.zeros((n, 2))), tensions=constant(breaks, np.zeros(n))
    )


def refused(motion: Motion) -> tuple[str, ...]:
    """Where ``interlacing`` fails, and that it says in which phase, and when."""
    check = certify(motion)["interlacing"]
    assert not check.holds
    assert check.where[0].startswith("phase ")
    phase = motion.phases[int(check.where[0].split()[1])]
    assert check.where[0].endswith(f"({phase.name})")
    assert phase.start - 1e-6 <= check.time <= phase.end + 1e-6
    return check.where


def fails(motion: Motion) -> bool:
    """Whether some check of a certificate fails; one is enough, and interlacing looks at states."""
    checks = (rule.check(motion) for rule in (INTERLACING, *RULES))
    return any(check is not None and not check.holds for check in checks)


def index_of(motion: Motion, name: str) -> int:
    return [phase.name for phase in motion.phases].index(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", TYING)
def test_renaming_every_phase_changes_no_figure(name: str) -> None:
    motion = planned(name).motion
    for names in (["take-off"], ["hold", "swap 1", "parked", "tighten"]):
        assert certify(renamed(motion, names)).to_dict() == certificate_of(name).to_dict()


@pytest.mark.slow
@pytest.mark.parametrize("name", TYING)
def test_every_other_state_fails(name: str) -> None:
    motion = planned(name).motion
    assert certificate_of(name).certified
    for i, phase in enumerate(motion.phases):
        for state in set(CABLES) - {phase.state}:
            assert fails(claimed(motion, i, state)), (phase.name, state)


@pytest.mark.parametrize(
    ("first", "state"),
    [
        ("approach", CableState.CLASPING),  # the time before a swap is not clasping
        ("swap 1", CableState.CLASPING),  # nor what follows: else nothing sees torn cables
        ("swap 1", CableState.TIGHTENING),
    ],
)
def test_phases_do_not_swallow_their_neighbours(first: str, state: CableState) -> None:
    motion = planned("tie_carry_untie").motion
    index = index_of(motion, first)
    assert motion.phases[index_of(motion, "swap 1") + 2].name == "tighten"
    assert set(refused(merged(motion, index, index + 2, state))[1:]) == {"p0", "p1", "p2"}


@pytest.mark.slow
def test_what_is_at_full_length_is_not_being_tightened() -> None:
    """Whatever the plan says of legs and tensions, and wherever it puts the clasps."""
    motion = planned("tie_carry_untie").motion
    tighten, loosen = index_of(motion, "tighten"), index_of(motion, "loosen")
    whole = merged(motion, tighten, loosen, CableState.TIGHTENING)
    assert set(refused(whole)[1:]) == {"cable 0", "cable 1", "cable 2"}
    whole = slackened(whole)
    assert set(refused(whole)[1:]) == {"cable 0", "cable 1", "cable 2"}
    moved = whole.vertices.coefficients.copy()
    moved[:, 0, 0] += 0.02
    elsewhere = replace(whole, vertices=PiecewisePolynomial(whole.drones.breaks, moved))
    assert set(refused(elsewhere)[1:]) == {"cable 0", "cable 1", "cable 2"}


def test_drones_with_cables_on_the_ground_do_not_fly_sideways() -> None:
    motion = planned("form_triangle").motion
    where = refused(merged(motion, 0, 1, CableState.GROUND))
    assert set(where[1:]) == {"cable 0", "cable 1", "cable 2"}


@pytest.mark.parametrize(
    ("height", "state"),
    [(0.0, CableState.GROUND), (0.3, CableState.GROUND), (2.0, CableState.FREE)],
)
def test_cables_on_the_ground_reach_it(height: float, state: CableState) -> None:
    """At rest: cables that come nearer to the ground than those that hang may do lie on it."""
    team = Team(3, 1.5)
    places = np.array([[x, y, height] for y in (0.0, 1.0, 2.0) for x in (4.0, 5.0)])
    drones = through(np.array([0.0, 1.0]), np.stack([places, places]))
    for each in (CableState.GROUND, CableState.FREE):
        assert certify(free_motion(team, drones, each)).certified is (each is state)


def test_a_clasp_turns_about_a_point_at_rest() -> None:
    """Swaps whose pairs wander by two millimetres as they turn."""
    motion = planned("form_triangle").motion
    swap = index_of(motion, "swap 1")
    run = motion.phase_of_piece
    c = motion.drones.coefficients.copy()
    layout = motion.team.layout
    middle = np.flatnonzero(run == swap)[len(np.flatnonzero(run == swap)) // 2]
    bump = np.zeros(c.shape[-1])
    bump[3:-3] = 0.02
    for drone in (2 * layout.ahead[1], 2 * layout.behind[1] + 1):
        c[middle, drone, 0] += bump
    wandering = replace(motion, drones=PiecewisePolynomial(motion.drones.breaks, c))
    met = chord_crossings(wandering.drones)
    assert np.all(met.certain)
    assert refused(wandering)[1:] == (f"p{layout.clasps[1]}",)


def test_no_leg_and_no_tension_without_a_hitch() -> None:
    motion = planned("form_triangle").motion
    tighten = np.flatnonzero(motion.phase_of_piece == index_of(motion, "tighten"))
    for part in ("legs", "tensions"):
        given: PiecewisePolynomial = getattr(motion, part)
        c = given.coefficients.copy()
        c[tighten[0], 1] += 0.1
        changed = PiecewisePolynomial(motion.drones.breaks, c)
        told = (
            replace(motion, legs=changed) if part == "legs" else replace(motion, tensions=changed)
        )
        assert refused(told) == (f"phase {index_of(motion, 'tighten')} (tighten)", "cable 1")
