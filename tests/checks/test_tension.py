"""Check ``tension``: jumps and ranges; how weight passes as a hitch is pulled tight and let go."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.optimize import brentq

import hitchopt as ho
from hitchopt.hitch import Team
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array, Indices
from tests.helpers.by_hand import assert_sound, thrusts
from tests.helpers.motions import SQUARE, altered, moving, plus, replaced, row, still
from tests.helpers.plans import planned

DENSITY = 0.008
TEAM = Team(4, [2.9, 2.8, 2.7, 3.0], tension=0.4)
check = partial(row, name="tension")


def triangle() -> Motion:
    return planned("triangle").motion


@cache
def tied() -> Motion:
    """Return drones of unequal cables that tie a hitch, hold it and release it."""
    left = np.array([[-0.5, 1.0, 1.6], [-0.5, 0.0, 1.6], [-0.5, -1.0, 1.6]]) + [0.7, -0.4, 0.0]
    polygon = np.array([[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]) + [0.7, -0.4]
    team = {
        "robots": 3,
        "cable_length": [2.4, 2.35, 2.3],
        "cable_density": DENSITY,
        "tension": [0.4, 0.45, 0.42],
    }
    form = {"form": {"polygon": polygon.tolist(), "altitude": 1.5}}
    mission = [form, {"hold": {"seconds": 0.3}}, {"release": {}}]
    drones = {"q": left.tolist(), "r": (left + [1.0, 0.0, 0.0]).tolist()}
    data = {"team": team, "start": {"drones": drones}, "mission": mission}
    return ho.solve(problem_from_dict(data)).motion


def pieces_of(motion: Motion, name: str) -> tuple[Phase, Indices]:
    index = [phase.name for phase in motion.phases].index(name)
    return motion.phases[index], np.flatnonzero(motion.phase_of_piece == index)


def lacking(motion: Motion) -> float:
    """Return the largest difference of a tension at the start of the rise from the team's [N]."""
    _, (first, *_) = pieces_of(motion, "tension")
    return float(np.max(motion.team.tension - motion.tensions.coefficients[first, ..., 0]))


def later_half(c: Array) -> None:
    c[len(c) // 2 :] *= 2.5


def scaled(factor: float) -> Callable[[Array], Array]:
    return lambda c: factor * c


@pytest.mark.parametrize(
    ("change", "worst"), [(later_half, 0.6), (scaled(1e-6), 0.4), (scaled(1.001), 4e-4)]
)
def test_tensions_other_than_the_teams_fail(
    change: Callable[[Array], object], worst: float
) -> None:
    assert check(triangle()).holds
    result = check(altered(triangle(), "tensions", change))
    assert not result.holds
    assert result.worst == pytest.approx(worst, rel=1e-5)
    assert (result.limit, result.unit, result.sense) == (1e-4, "N", "max")


@pytest.mark.parametrize("change", [later_half, scaled(1.001), scaled(0.0)])
def test_plans_that_tie_and_untie_are_checked_as_well(change: Callable[[Array], object]) -> None:
    assert check(tied()).holds
    assert not check(altered(tied(), "tensions", change)).holds


@pytest.mark.parametrize(
    ("name", "share"), [("tension", 2e-4), ("relax", 2e-4), ("tighten", 0.05), ("loosen", 0.05)]
)
def test_the_certificate_and_the_setpoints_follow_one_law(name: str, share: float) -> None:
    """Of a ramp, and of its middle, where both laws count; the weight that cables put on drones
    is theirs all along, but for a share by which legs slope otherwise; and nothing jumps."""
    motion = tied()
    phase, (piece, *_) = pieces_of(motion, name)
    ramp = motion.slice_pieces(slice(piece, piece + 1), (phase,))
    start, span = float(ramp.drones.breaks[0]), ramp.duration
    t = start + span * np.linspace(0.0, 0.999, 2_001)
    states = states_at(motion, t)
    np.testing.assert_allclose(states.thrusts(motion.team), thrusts(ramp, t), atol=1e-8)
    assert np.max(np.abs(np.diff(states.tensions, axis=0))) > 0.0
    weight = -9.81 * DENSITY * np.sum(motion.team.cable_length)
    np.testing.assert_allclose(states.cable_forces[..., 2].sum(axis=1), weight, rtol=share)
    ends = start + span * np.array([0.4, 0.6])

    def middle(part: PiecewisePolynomial) -> PiecewisePolynomial:
        return PiecewisePolynomial(ends, bernstein.restrict(part.coefficients, 0.4, 0.6))

    only = frozenset({"thrust", "tilt", "body_rate"})
    for run in (ramp, ramp.map_curves(middle, (phase,))):
        assert_sound(replaced(run, body_rate=1.0), 801, 1e-3, 0.0, only)
    steps = []
    for count in (1_001, 8_001):  # over both ends of the ramp
        near = states_at(motion, np.linspace(start - 0.05, start + span + 0.05, count))
        each = np.stack([near.cable_forces, near.thrusts(motion.team)])
        steps.append(np.max(np.linalg.norm(np.diff(each, axis=1), axis=-1), axis=(1, 2)))
    np.testing.assert_allclose(steps[0] / steps[1], 8.0, rtol=0.05)


def route_at_end(motion: Motion) -> Array:
    """Return the horizontal lengths (n,) [m] of cables along their vertices, as they are tight."""
    _, (*_, last) = pieces_of(motion, "tighten")
    drones, vertices = (
        part.coefficients[last, :, :2, -1] for part in (motion.drones, motion.vertices)
    )
    onward = np.roll(vertices, -1, axis=0)
    parts = drones[0::2] - vertices, onward - vertices, drones[1::2] - onward
    routes: Array = np.sum(np.linalg.norm(parts, axis=-1), axis=0)
    return routes


def hanging_tension(route: float, cable: float, density: float) -> float:
    """Return the tension [N] with which the arc over a horizontal route is as long as the cable."""
    weight = 9.81 * density

    def excess(tension: float) -> float:
        half = 0.5 * weight * route / tension
        return route * math.sinh(half) / half - cable

    return float(brentq(excess, 0.01 * weight * cable, 1e4 * weight * cable))


def test_cables_pull_as_they_hang_before_tensions_rise() -> None:
    """In plan view a cable is a catenary over its route: where drones are as planned, with the full
    tension; where they are held back by a centimetre, with the one from which tensions rise."""
    motion = tied()
    team, routes = motion.team, route_at_end(motion)
    _, (first, *_) = pieces_of(motion, "tension")
    start = motion.tensions.coefficients[first, :, 0]

    def shares(shorter: float) -> Array:
        pairs = zip(routes - shorter, team.cable_length, strict=True)
        hanging = np.array([hanging_tension(*pair, DENSITY) for pair in pairs])
        return np.asarray(hanging / team.tension)

    np.testing.assert_allclose(shares(0.0), 1.0, atol=0.08)  # unequal ones lift each other
    np.testing.assert_allclose(start / team.tension, np.max(shares(0.02)), rtol=1e-6)
    assert 0.5 < start[0] / team.tension[0] < 0.9


@pytest.mark.parametrize(("value", "excess"), [(1.0, 0.6), (-0.3, 0.3)])
def test_tightened_cables_pull_with_at_most_the_teams_tension(value: float, excess: float) -> None:
    motion, (_, pieces) = tied(), pieces_of(tied(), "tighten")
    result = check(altered(motion, "tensions", partial(set_piece, pieces[len(pieces) // 2], value)))
    assert not result.holds
    assert result.worst == pytest.approx(excess, abs=0.3)


def set_piece(piece: int, value: float, c: Array) -> None:
    c[piece] = value


def test_a_hitch_that_forms_at_once_jumps() -> None:
    """The jump is that of the tension, also of a rise whose range says that it is none."""
    motion = tied()
    full = motion.team.tension[:, None] * motion.formed[:, None, None]
    at_once = altered(motion, "tensions", lambda c: full + 0.0 * c)
    assert check(at_once).worst == pytest.approx(0.45, abs=0.1)
    phases = [replace(p, tension=(1e-5, 1.0)) if p.name == "tension" else p for p in motion.phases]
    worst = check(replace(motion, phases=tuple(phases))).worst
    assert worst == pytest.approx(lacking(motion), abs=1e-3)


@pytest.mark.parametrize("part", ["drones", "vertices"])
def test_nothing_moves_on_a_ramp(part: str) -> None:
    motion, (_, (piece, *_)) = tied(), pieces_of(tied(), "tension")
    finer = motion.replaced(**{part: getattr(motion, part).elevated(7)})
    result = check(altered(finer, part, plus((piece, ..., 4), 1e-6)))
    assert not result.holds
    assert result.worst == pytest.approx(lacking(motion), abs=1e-3)
    assert result.where == (motion.team.cable_names[int(np.argmax(motion.team.tension))],)


def test_ramps_are_next_to_spans_without_a_hitch() -> None:
    motion, (_, (piece, *_)) = tied(), pieces_of(tied(), "tension")
    alone = motion.slice_pieces(
        slice(piece, piece + 2), [p for p in motion.phases if p.state.hitched]
    )
    assert check(alone).worst == pytest.approx(lacking(motion), abs=1e-3)
    team = motion.team.tension[:, None]

    def again(c: Array) -> None:  # down and up once more, as a hitch at rest is held
        c[piece + 1] = 0.0
        c[piece + 1][..., [0, 1, -2, -1]] = team

    held = altered(motion, "tensions", again)
    t = np.linspace(held.tensions.breaks[piece + 1], held.tensions.breaks[piece + 2], 20_001)
    lost = np.max(motion.team.tension - held.tensions.at(t))
    assert check(held).worst == pytest.approx(lost, rel=1e-3)


def swinging(least: float, most: float) -> Motion:
    """Return a hitch at rest whose tensions go from the team's down to 0.34 N and back."""

    def tension_at(t: float) -> Array:
        tensions: Array = 0.4 - (0.5 - 0.5 * np.cos(np.pi * t)) * np.array([0.06, 0.03, 0.0, 0.02])
        return tensions

    motion = still(TEAM, SQUARE, np.full(4, 0.6), order=9, tension_at=tension_at)
    return replace(motion, phases=(Phase("morph", 0, 0.0, 2.0, tension=(least, most)),))


@pytest.mark.parametrize(
    ("least", "most", "worst"),
    [(0.3, 0.5, 0.0), (0.34, 0.4, 0.0), (0.35, 0.5, 0.01), (0.2, 0.36, 0.04), (0.35, 0.36, 0.04)],
)
def test_tensions_stay_within_the_stated_range(least: float, most: float, worst: float) -> None:
    result = check(swinging(least, most))
    assert result.worst == pytest.approx(worst, abs=2e-6)
    assert result.holds == (worst == 0.0)
    if least == 0.35 and most == 0.5:
        assert result.where == ("cable 0",)
        assert result.time == pytest.approx(1.0, abs=0.05)
    plain = replace(swinging(least, most), phases=(Phase("morph", 0, 0.0, 2.0),))
    assert check(plain).worst == pytest.approx(0.06, abs=2e-6)


@pytest.mark.parametrize("factor", [1e-6, 2.0])
def test_a_stated_range_begins_and_ends_with_the_teams_tension(factor: float) -> None:
    """However wide it is said to be, and it ends with its phase."""
    motion = swinging(1e-7, 10.0)
    assert check(motion).holds
    assert check(altered(motion, "tensions", scaled(factor))).worst > 0.3
    half = (replace(motion.phases[0], end=1.0), Phase("morph", 1, 1.0, 2.0, tension=(0.3, 0.5)))
    result = check(replace(motion, phases=half))
    assert result.worst == pytest.approx(0.06, abs=2e-6)
    assert result.time == pytest.approx(1.0)


@pytest.mark.parametrize(("end", "worst"), [(1.0, 0.0), (0.6, 0.06)])
def test_a_range_does_not_hold_on_pieces_that_lie_partly_within_its_phase(
    end: float, worst: float
) -> None:
    def once(c: Array) -> None:
        x = bernstein.nodes(bernstein.degree(c))
        c[0] = bernstein.interpolate(0.4 - 0.06 * np.sin(np.pi * x) ** 2)
        c[1] = 0.4

    motion = altered(swinging(0.3, 0.5), "tensions", once)
    phases = (replace(motion.phases[0], end=end), Phase("hold", 1, end, 2.0))
    result = check(replace(motion, phases=phases))
    assert result.worst == pytest.approx(worst, abs=1e-3 * worst + 1e-9)


def rough() -> Motion:
    """The same of cables with friction, whose legs pull as they do."""
    motion = swinging(0.2, 0.6)
    pulls = np.repeat(motion.tensions.coefficients[:, :, None], 2, axis=2)
    legs = PiecewisePolynomial(motion.drones.breaks, pulls)
    return replace(motion, team=replace(TEAM, cable_friction=1.0), leg_tensions=legs)


@pytest.mark.parametrize("part", ["tensions", "leg_tensions"])
def test_jumps_within_the_range_are_detected(part: str) -> None:
    assert check(rough()).holds
    result = check(altered(rough(), part, plus((1, 2, ..., 0), 0.003)))
    assert not result.holds
    assert result.worst == pytest.approx(0.003, rel=1e-6)
    assert result.time == pytest.approx(1.0)


def test_jumps_of_pulls_are_detected_without_jumps_of_thrust() -> None:
    """The drone accelerates at the same time, by as much as its leg pulls harder."""
    motion = rough()
    leg = motion.drones.at(1.0)[5] - motion.vertices.at(1.0)[3]
    less = -0.003 / 0.132 / 72.0 * leg / np.linalg.norm(leg)
    motion = altered(motion, "leg_tensions", plus((1, 2, 1, 0), 0.003))
    motion = altered(motion, "drones", plus((1, 5, slice(None), 2), less))
    states = states_at(motion, [1.0 - 1e-9, 1.0])
    assert np.max(np.abs(np.diff(states.thrusts(motion.team), axis=0))) < 1e-6
    result = check(motion)
    assert result.worst == pytest.approx(0.003, rel=1e-6)
    assert result.where == ("r2",)


def test_jumps_of_thrusts_with_accelerations_are_detected() -> None:
    team = Team(4, [2.9, 2.8, 2.7, 3.0], cable_density=0.004)
    motion = moving(team, lambda t: SQUARE + 0.1 * np.sin(t), np.full(4, 0.6), order=9)
    assert check(motion).holds
    # An acceleration of 0.01 m/s² on r2 where a piece begins.
    bent = 0.01 * motion.drones.durations[0] ** 2 / 72.0
    result = check(altered(motion, "drones", plus((3, 5, 0, 2), bent)))
    assert result.worst == pytest.approx(0.132 * 0.01, rel=1e-3)
    assert result.where == ("r2",)
    assert result.time == pytest.approx(motion.drones.breaks[3])
