"""Check ``tension``, and how a cable's weight passes as its hitch is pulled tight and let go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from certificate_cases import applied, moving, still, with_parts
from numpy.typing import NDArray
from plans import planned

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.checks.cables import TENSION as RULE
from hitchopt.checks.cables import TENSION_LIMIT as LIMIT
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

DENSITY = 0.008
SQUARE = [[2.0, 0.3], [1.2, -1.0], [0.1, -0.4], [0.5, 0.6]]


check = partial(applied, RULE)


def triangle() -> Motion:
    return planned("triangle").motion


@cache
def tied() -> Motion:
    """Return drones of unequal cables that tie a hitch, hold it and let it go."""
    lines = np.array([[-0.5, 1.0, 1.6], [-0.5, 0.0, 1.6], [-0.5, -1.0, 1.6]]) + [0.7, -0.4, 0.0]
    polygon = np.array([[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]) + [0.7, -0.4]
    team = {
        "robots": 3,
        "cable_length": [2.4, 2.35, 2.3],
        "cable_density": DENSITY,
        "tension": [0.4, 0.45, 0.42],
    }
    mission = [
        {"form": {"polygon": polygon.tolist(), "altitude": 1.5}},
        {"hold": {"seconds": 0.3}},
        {"release": {}},
    ]
    right = lines + [1.0, 0.0, 0.0]
    drones = {"q": lines.tolist(), "r": right.tolist()}
    data = {"team": team, "start": {"drones": drones}, "mission": mission}
    plan = ho.solve(problem_from_dict(data))
    assert isinstance(plan.motion, Motion)
    return plan.motion


def times_of(motion: Motion, name: str) -> tuple[float, float]:
    return next((p.start, p.end) for p in motion.phases if p.name == name)


def pulling(motion: Motion, change: Callable[[Array], Array], part: str = "tensions") -> Motion:
    """Return the motion with coefficients of tensions changed."""
    given = getattr(motion, part)
    changed: Any = PiecewisePolynomial(given.breaks, change(given.coefficients.copy()))
    return replace(motion, **{part: changed})


def later_half(c: Array) -> Array:
    c[len(c) // 2 :] *= 2.5
    return c


def scaled(factor: float) -> Callable[[Array], Array]:
    return lambda c: factor * c


@pytest.mark.parametrize(
    ("change", "worst"), [(later_half, 0.6), (scaled(1e-6), 0.4), (scaled(1.001), 4e-4)]
)
def test_tensions_that_the_team_has_not_fail(
    change: Callable[[Array], Array], worst: float
) -> None:
    assert check(triangle()).holds
    found = check(pulling(triangle(), change))
    assert not found.holds
    assert found.worst == pytest.approx(worst, rel=1e-5)
    assert (found.limit, found.unit, found.sense) == (LIMIT, "N", "max")


@pytest.mark.parametrize("change", [later_half, scaled(1.001)])
def test_a_plan_that_ties_and_unties_is_no_excuse(change: Callable[[Array], Array]) -> None:
    assert check(tied()).holds
    assert not check(pulling(tied(), change)).holds


def test_forces_of_cables_do_not_jump_where_a_hitch_forms_and_lets_go() -> None:
    """Steps of forces and thrusts between samples become smaller as these become denser."""
    motion = tied()
    steps: dict[int, list[float]] = {}
    for count in (1_001, 8_001):
        for name in ("tension", "relax"):
            start, end = times_of(motion, name)
            states = states_at(motion, np.linspace(start - 0.05, end + 0.05, count))
            for what in (states.cable_forces, states.thrusts(motion.team)):
                moved = np.linalg.norm(np.diff(what, axis=0), axis=-1)
                steps.setdefault(count, []).append(float(np.max(moved)))
    # 35/16 of 0.45 N over the rise at most, and jerks of 20 m/s³ before and after.
    start, end = times_of(motion, "tension")
    apart, fastest = 1e-3 * (end - start + 0.1), 0.985 / (end - start)
    assert max(steps[1_001]) < apart * (fastest + 0.132 * 20.0)
    assert min(steps[1_001]) < apart * fastest
    np.testing.assert_allclose(np.array(steps[1_001]) / steps[8_001], 8.0, rtol=0.05)


def forces_by_hand(motion: Motion, t: Array) -> Array:
    """Return (times, 2n, 3): what cables put on drones of a tied hitch whose tension changes."""
    team, x, p = motion.team, motion.drones.at(t), motion.vertices.at(t)
    T = motion.tensions.at(t)
    share = T / team.tension
    found = np.zeros(x.shape)
    for k in range(team.robots):
        q, r = x[:, 2 * k], x[:, 2 * k + 1]
        hanging = 9.81 * DENSITY * Catenary.between(q, r, team.cable_length[k]).pull(q, r)
        for end, vertex in ((0, k), (1, (k + 1) % team.robots)):
            leg = x[:, 2 * k + end] - p[:, vertex]
            size = np.linalg.norm(leg, axis=1)
            half = share[:, k] * 9.81 * DENSITY / 2.0
            level = np.sqrt(T[:, k] ** 2 - half**2 * (leg[:, 0] ** 2 + leg[:, 1] ** 2))
            pull = -((level + half * leg[:, 2]) / size)[:, None] * leg
            pull[:, 2] -= half * size
            found[:, 2 * k + end] = pull + (1.0 - share[:, k, None]) * hanging[:, end]
    return found


@pytest.mark.parametrize("name", ["tension", "relax"])
def test_the_certificate_and_the_setpoints_follow_one_law(name: str) -> None:
    motion = tied()
    t = np.linspace(*times_of(motion, name), 4_001)[:-1]
    states = states_at(motion, t)
    expected = forces_by_hand(motion, t)
    np.testing.assert_allclose(states.cable_forces, expected, atol=1e-8)
    assert np.max(np.abs(np.diff(motion.tensions.at(t), axis=0))) > 0.0
    weight = states.cable_forces[..., 2].sum(axis=1)
    own = -9.81 * DENSITY * np.sum(motion.team.cable_length)
    np.testing.assert_allclose(weight, own, rtol=2e-4)  # but for what legs are longer by sagging
    pieces = np.flatnonzero(
        (motion.drones.breaks[:-1] > t[0] - 1e-6) & (motion.drones.breaks[1:] < t[-1] + 1e-3)
    )
    phase = next(p for p in motion.phases if p.name == name)
    ramp = motion.taken(slice(int(pieces[0]), int(pieces[-1]) + 1), (phase,))
    thrust = motion.team.mass[:, None] * [0.0, 0.0, 9.81] - expected
    size = np.linalg.norm(thrust, axis=-1)
    tilt = np.degrees(np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2]))
    for middle in (False, True):  # half way in the ramp as well, where both laws count
        run = with_parts(ramp, _middle) if middle else ramp
        rows = slice(1_600, 2_401) if middle else slice(None)
        for what, sampled in (("thrust", np.max(size[rows])), ("tilt", np.max(tilt[rows]))):
            worst = certify(run)[what].worst
            assert sampled - 1e-9 <= worst <= sampled * 1.001


def _middle(part: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the middle fifth of a single piece."""
    start, h = part.breaks[0], part.duration
    c = bernstein.restrict(part.coefficients, 0.4, 0.6)
    return PiecewisePolynomial(np.array([start + 0.4 * h, start + 0.6 * h]), c)


def test_a_hitch_that_forms_at_once_jumps() -> None:
    """The jump is that of the full tension; a hitch that never pulls fails as well."""
    motion = tied()
    full = motion.team.tension[:, None] * np.ones((motion.drones.pieces, 1, 8))
    at_once = pulling(motion, lambda _: np.where(motion.formed[:, None, None], full, 0.0))
    found = check(at_once)
    assert found.worst == pytest.approx(0.45, abs=0.1)
    assert not check(pulling(motion, lambda c: 0.0 * c)).holds
    # Nor does a ramp become one by a range that says so.
    phases = [replace(p, tension=(1e-5, 1.0)) if p.name == "tension" else p for p in motion.phases]
    assert check(replace(motion, phases=tuple(phases))).worst == pytest.approx(0.45, abs=1e-3)


def test_a_ramp_rests_beside_a_span_without_a_hitch() -> None:
    motion = tied()
    ramp = motion.tensions.breaks[:-1] == times_of(motion, "tension")[0]
    (piece,) = np.flatnonzero(ramp)
    assert check(motion).holds

    def shaken(part: PiecewisePolynomial) -> Any:
        c = part.elevated(7).coefficients.copy()
        c[piece, ..., 4] += 1e-6
        return PiecewisePolynomial(part.breaks, c)

    for part in ("drones", "vertices"):
        moving_ramp = replace(motion, **{part: shaken(getattr(motion, part))})
        found = check(moving_ramp)
        assert not found.holds
        assert found.worst == pytest.approx(0.45, abs=1e-3)
        assert found.where == (f"cable {np.argmax(motion.team.tension)}",)
    held_phases = [phase for phase in motion.phases if phase.formed]
    alone = motion.taken(slice(piece, piece + 2), held_phases)
    assert check(alone).worst == pytest.approx(0.45, abs=1e-3)

    def again(c: Array) -> Array:  # down and up once more, as a hitch at rest is held
        c[piece + 1] = c[piece] * [1, 1, 1, 1, 0, 0, 0, 0] + c[piece][..., ::-1]
        c[piece + 1][..., :2] = c[piece + 1][..., -2:] = motion.team.tension[:, None]
        c[piece + 1][..., 2:-2] = 0.0
        return c

    held = pulling(motion, again)
    found = check(held)
    start, end = motion.tensions.breaks[piece + 1 : piece + 3]
    t = np.linspace(start, end, 20_001)
    lost = np.max(motion.team.tension - held.tensions.at(t))
    assert found.worst == pytest.approx(lost, rel=1e-3)


def swinging(least: float, most: float) -> Motion:
    """Return a hitch at rest whose tensions go from the team's down to 0.34 N and back."""
    team = Team(4, [2.9, 2.8, 2.7, 3.0], tension=0.4)

    def tension_at(t: Array) -> Array:
        swing = 0.5 - 0.5 * np.cos(np.pi * t[:, None])
        values: Array = 0.4 - swing * np.array([0.06, 0.03, 0.0, 0.02])
        return values

    motion = still(team, np.array(SQUARE), np.full(4, 0.6), order=9, tension_at=tension_at)
    return replace(motion, phases=(Phase("morph", 0, 0.0, 2.0, tension=(least, most)),))


@pytest.mark.parametrize(
    ("least", "most", "worst"),
    [(0.3, 0.5, 0.0), (0.34, 0.4, 0.0), (0.35, 0.5, 0.01), (0.2, 0.36, 0.04), (0.35, 0.36, 0.04)],
)
def test_tensions_keep_to_the_range_that_their_step_states(
    least: float, most: float, worst: float
) -> None:
    found = check(swinging(least, most))
    assert found.worst == pytest.approx(worst, abs=2e-6)
    assert found.holds == (worst == 0.0)
    if least == 0.35 and most == 0.5:
        assert found.where == ("cable 0",)
        assert found.time == pytest.approx(1.0, abs=0.05)
    plain = replace(swinging(least, most), phases=(Phase("morph", 0, 0.0, 2.0),))
    assert check(plain).worst == pytest.approx(0.06, abs=2e-6)


def test_a_stated_range_begins_and_ends_with_the_teams_tension() -> None:
    """However wide it is said to be, and it ends with its phase."""
    motion = swinging(1e-7, 10.0)
    assert check(motion).holds
    for change in (scaled(1e-6), scaled(2.0)):
        found = check(pulling(motion, change))
        assert not found.holds
        assert found.bound > 0.3
    half = (replace(motion.phases[0], end=1.0), Phase("morph", 1, 1.0, 2.0, tension=(0.3, 0.5)))
    found = check(replace(motion, phases=half))
    assert found.worst == pytest.approx(0.06, abs=2e-6)
    assert found.time == pytest.approx(1.0)


def test_a_range_does_not_hold_on_pieces_that_lie_partly_within_its_phase() -> None:
    motion = swinging(0.3, 0.5)

    def once(c: Array) -> Array:
        x = bernstein.nodes(bernstein.degree(c))
        c[0] = bernstein.interpolate(0.4 - 0.06 * np.sin(np.pi * x) ** 2)
        c[1] = 0.4
        return c

    motion = pulling(motion, once)
    for end, worst in ((1.0, 0.0), (0.6, 0.06)):
        phases = (replace(motion.phases[0], end=end), Phase("hold", 1, end, 2.0))
        found = check(replace(motion, phases=phases))
        assert found.worst == pytest.approx(worst, abs=1e-3 * worst + 1e-9)


def rough(team: Team) -> Team:
    return Team(team.robots, team.cable_length, tension=team.tension, cable_friction=1.0)


@pytest.mark.parametrize("part", ["tensions", "leg_tensions"])
def test_a_jump_within_the_range_is_found(part: str) -> None:
    motion = swinging(0.2, 0.6)
    pulls = np.repeat(motion.tensions.coefficients[:, :, None], 2, axis=2)
    motion = replace(
        motion,
        team=rough(motion.team),
        leg_tensions=PiecewisePolynomial(motion.drones.breaks, pulls),
    )
    assert check(motion).holds

    def stepped(c: Array) -> Array:
        c[1, 2, ..., 0] += 0.003
        return c

    found = check(pulling(motion, stepped, part))
    assert not found.holds
    assert found.worst == pytest.approx(0.003, rel=1e-6)
    assert found.time == pytest.approx(1.0)


def test_a_pull_that_jumps_is_found_where_the_thrust_does_not() -> None:
    """The drone accelerates at the same time, by as much as its leg pulls harder."""
    motion = swinging(0.2, 0.6)
    pulls = np.repeat(motion.tensions.coefficients[:, :, None], 2, axis=2)
    pulls[1, 2, 1, 0] += 0.003
    leg = motion.drones.at(1.0)[5] - motion.vertices.at(1.0)[3]
    c = motion.drones.coefficients.copy()
    c[1, 5, :, 2] -= 0.003 / 0.132 / 72.0 * leg / np.linalg.norm(leg)
    motion = replace(
        motion,
        team=rough(motion.team),
        drones=PiecewisePolynomial(motion.drones.breaks, c),
        leg_tensions=PiecewisePolynomial(motion.drones.breaks, pulls),
    )
    states = states_at(motion, [1.0 - 1e-9, 1.0])
    assert np.max(np.abs(np.diff(states.thrusts(motion.team), axis=0))) < 1e-6
    found = check(motion)
    assert found.worst == pytest.approx(0.003, rel=1e-6)
    assert found.where == ("r2",)


def test_thrusts_that_jump_with_accelerations_are_found() -> None:
    motion = moving(
        Team(4, [2.9, 2.8, 2.7, 3.0], cable_density=0.004),
        lambda t: np.array(SQUARE) + 0.1 * np.sin(t)[:, None, None],
        np.full(4, 0.6),
        order=9,
    )
    assert check(motion).holds
    c = motion.drones.coefficients.copy()
    bent = 0.01 * motion.drones.durations[0] ** 2 / 72.0
    c[3, 5, 0, 2] += bent  # an acceleration of 0.01 m/s² on r2 where the piece begins
    found = check(replace(motion, drones=PiecewisePolynomial(motion.drones.breaks, c)))
    assert found.worst == pytest.approx(0.132 * 0.01, rel=1e-3)
    assert found.where == ("r2",)
    assert found.time == pytest.approx(motion.drones.breaks[3])
