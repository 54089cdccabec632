"""Hitches tied by laying: what is right, and lies about order, sense and states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.checks.clasps import roll_changes
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import steepness
from hitchopt.hitch.forces import sag_factors
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase, concatenated
from hitchopt.motion.retiming import resting as at_rest
from hitchopt.planners.forming.laying import (
    Laying,
    RollPath,
    find_laying,
    levels_of,
    roll_motion,
    senses_of,
    split_for_rolling,
)
from hitchopt.planners.forming.stages import reversed_stages, stage, straight_lines
from hitchopt.verify import links
from tests.helpers.by_hand import point_to_segment, segment_to_segment
from tests.helpers.motions import altered, plus, row
from tests.helpers.second_opinions import Rows, opinion_of
from tests.helpers.swaps import stages_of as swaps_of

SPEC = Requirements()
RINGS = {3: (1.3, 2.3), 6: (1.0, 1.9)}
LAYING, ROLLING = CableState.LAYING, CableState.ROLLING
ORDER = links.interlacing


@cache
def laying_of(n: int, order: tuple[int, ...] | None = None) -> Laying:
    """Return a ring off the origin, with cables of 10 g/m."""
    edge, length = RINGS[n]
    team = Team(n, length, tension=0.7, cable_density=0.01)
    polygon = ho.regular_polygon(n, edge, angle=0.3).vertices + [4.0, -3.0]
    levels = levels_of(team.layout, order)
    halves = Hitch.balanced(team, ho.ConvexPolygon(polygon), 1.8)
    hitch = split_for_rolling(halves, senses_of(team.layout, levels), SPEC)
    return find_laying(hitch, levels, SPEC)


@cache
def stages_of(n: int, order: tuple[int, ...] | None = None) -> list[Motion]:
    return laying_of(n, order).stages(SPEC)


def wrong(motions: Sequence[Motion]) -> set[str]:
    result = row(concatenated(motions), "interlacing")
    assert (result.worst == 0.0) is result.holds is (not result.where)
    return {name for name in result.where if not name.startswith("phase ")}


def clasps(n: int) -> set[str]:
    return {f"p{k}" for k in range(n)}


def lowered(laying: Laying, start: np.ndarray, end: np.ndarray) -> Motion:
    """Return cables that are laid along straight lines."""
    team = laying.hitch.team
    return stage("lay", straight_lines(team, SPEC.limits, start, end), team, SPEC, 0, LAYING)


def rolled(laying: Laying, start: np.ndarray, end: np.ndarray) -> Motion:
    return roll_motion(RollPath(laying.hitch, start, end), SPEC, Phase("roll", 0, 0.0, 0.0))


@pytest.mark.parametrize(("n", "order"), [(3, None), (3, (2, 0, 1)), (6, None)])
def test_laid_hitches_hold_for_all_times_and_come_apart_backwards(
    n: int, order: tuple[int, ...] | None
) -> None:
    stages = stages_of(n, order)
    certificate = certify(concatenated([*stages, *reversed_stages(stages)]), reports=())
    assert certificate.certified, certificate
    assert certificate["equilibrium"].worst < 1e-4


@pytest.mark.parametrize("n", RINGS)
def test_rolls_are_in_equilibrium_and_open_at_half_a_turn(n: int) -> None:
    laying = laying_of(n)
    start, change = roll_changes(rolled(laying, laying.path.start, laying.path.end))
    assert np.abs(start) == pytest.approx(180.0, abs=1e-6)
    assert change == pytest.approx(180.0 * laying.senses, abs=1e-6)
    # Both cables run straight through their vertices, but for what they sag.
    drones, vertices = laying.drones_laid, laying.hitch.vertices
    legs = drones - vertices[laying.hitch.team.layout.anchors]
    u = laying.hitch.polygon.edge_directions
    along = legs[0::2, :2] / np.linalg.norm(legs[0::2], axis=1)[:, None]
    assert np.sum(along * u, axis=1) == pytest.approx(-1.0, abs=0.02)


@pytest.mark.parametrize(("n", "order"), [(3, None), (3, (1, 2, 0)), (6, None)])
def test_no_sampled_drone_is_nearer_to_a_laid_cable_than_certified(
    n: int, order: tuple[int, ...] | None
) -> None:
    """Cables run from drone to drone while they are laid, and sag by up to 5 cm."""
    for motion in stages_of(n, order):
        if motion.phases[0].state is not LAYING:
            continue
        breaks = motion.drones.breaks
        times = np.concatenate([np.linspace(breaks[0], breaks[-1], 4001), breaks])
        drones = motion.drones.at(times)
        first, last = drones[:, None, 0::2], drones[:, None, 1::2]
        distances = point_to_segment(drones[:, :, None], first, last)
        distances[:, np.arange(2 * n), np.arange(2 * n) // 2] = np.inf
        nearest, certified = np.min(distances), row(motion, "cable_clearance").worst
        assert nearest - 0.05 <= certified <= nearest + 1e-12


def test_levels_follow_the_order_and_neighbours_differ() -> None:
    layout = laying_of(6).hitch.team.layout
    assert levels_of(layout, None).tolist() == [0, 1, 0, 1, 0, 1]
    assert levels_of(layout, [0, 1, 2, 3, 4, 5]).tolist() == [0, 1, 2, 3, 4, 5]
    assert levels_of(layout, [1, 3, 5, 0, 2, 4]).tolist() == [1, 0, 1, 0, 1, 0]
    three = laying_of(3).hitch.team.layout
    assert levels_of(three, None).tolist() == [0, 1, 2]
    assert senses_of(three, np.array([0, 1, 2])).tolist() == [-1.0, 1.0, 1.0]


@pytest.mark.parametrize("n", RINGS)
def test_rolling_in_the_wrong_sense_is_refused(n: int) -> None:
    laying, stages = laying_of(n), stages_of(n)
    turned = rolled(laying, -laying.path.start, laying.path.end)
    assert wrong([*stages[:-1], turned]) == clasps(n)
    one = laying.path.start.copy()
    one[1] *= -1.0
    assert wrong([*stages[:-1], rolled(laying, one, laying.path.end)]) == {"p1"}
    # The right half turn, but of cables that were laid in another order.
    other = find_laying(laying.hitch, laying.levels[::-1].copy(), SPEC)
    assert wrong([*other.stages(SPEC)[:-1], stages[-1]]) == (
        {f"p{k}" for k in np.flatnonzero(laying.senses != other.senses)}
    )


def test_half_a_turn_too_little_or_too_much_is_refused() -> None:
    laying, stages = laying_of(3), stages_of(3)
    path = laying.path
    hold = stages[-1].slice_pieces(slice(-1, None), ())
    hold = hold.replaced(phases=(Phase("hold", 0, *hold.drones.breaks[[0, -1]].tolist()),))
    through = rolled(laying, path.start, -path.start)
    assert wrong([*stages[:-1], through]) == clasps(3)
    back = rolled(laying, path.end, path.start)
    assert not wrong([*stages, back])
    resting = replace(stages[-2], phases=(replace(stages[-2].phases[0], state=CableState.HITCHED),))
    assert wrong([*stages, back, resting]) == clasps(3)
    assert not row(concatenated([*stages, back, resting]), "equilibrium").holds
    # A pair that is open by 140 degrees alone is not lifted.
    partly = rolled(laying, path.end, path.start * [1.0, 140.0 / 180.0, 1.0])
    assert wrong([*stages, partly, *reversed_stages(stages)[1:]]) == {"p1"}
    # A closed one turns around within a piece, too far to be followed.
    held = at_rest(stages[-1], 1.0, Phase("rest", 0, 0.0, 1.0))
    opening = rolled(laying, path.end, path.start * [1.0, 0.0, 0.0])
    assert not wrong([*stages, held, opening])
    around = altered(opening, "drones", plus((9, 2, 2, slice(2, -2)), 2.0))
    assert wrong([*stages, held, around]) == {"p1"}
    # Opened to the other side, cables are wound around each other by a full turn.
    assert wrong([*stages, rolled(laying, path.end, -path.start)]) == clasps(3)


def resting(motion: Motion, state: CableState) -> Motion:
    """Return a rest at the end of a motion, in another state, whatever its pairs."""
    phase = Phase("rest", 0, 0.0, 1.0, state=state)
    return replace(at_rest(motion, 1.0, phase), phases=(phase,))


def second_opinion(motions: Sequence[Motion], path: Path, *functions: Rows) -> str:
    """Return what ``verify`` does not prove of a plan, by some of its functions or by all."""
    rows = opinion_of(concatenated(motions), path, *functions)
    return " ".join(str(each) for each in rows if each.verdict != "proven")


def test_untied_pairs_do_not_roll_and_tied_ones_are_not_laid(tmp_path: Path) -> None:
    laying, roll = laying_of(3), stages_of(3)[-1]
    team, closed = laying.hitch.team, laying.hitch.drones
    pairs = closed.reshape(-1, 2, 3)
    slack = np.mean(pairs, axis=1, keepdims=True) + 0.9 * (
        pairs - np.mean(pairs, axis=1, keepdims=True)
    )
    lines = straight_lines(team, SPEC.limits, slack.reshape(-1, 3), closed)
    pulled = stage("draw", lines, team, SPEC, 0, CableState.FREE)
    assert wrong([pulled, roll]) == clasps(3)
    hitched = resting(roll, CableState.HITCHED)
    assert wrong([pulled, resting(roll, ROLLING), hitched]) >= clasps(3)
    assert wrong([hitched, resting(roll, ROLLING)]) == {f"cable {k}" for k in range(3)}
    aside = lowered(laying, closed, closed + [1.0, 0.0, 0.0])
    assert wrong([hitched, aside]) == clasps(3)
    untied = [pulled, resting(roll, ROLLING)]
    assert wrong(untied) >= clasps(3)
    assert "unlinked cables roll" in second_opinion(untied, tmp_path, ORDER)
    assert "linked cables are laid" in second_opinion([hitched, aside], tmp_path, ORDER)
    shut = [hitched, resting(roll, ROLLING)]
    assert "no pair rolls or lies across" in second_opinion(shut, tmp_path)


def past(n: int, pair: int, degrees: float, when: str) -> list[Motion]:
    """Return a ring with a pair that opens, rolls past lying across by an angle, and closes."""
    laying, stages = laying_of(n), stages_of(n)
    shut, open_ = laying.path.end, laying.path.end.copy()
    open_[pair] = laying.path.start[pair]
    beyond = open_.copy()
    beyond[pair] += np.radians(degrees) * np.sign(open_[pair])
    turns = {
        "open": [shut, beyond, open_, shut],
        "hold": [shut, open_, beyond, open_, shut],
        "close": [shut, open_, beyond, shut],
    }[when]
    rolls = [rolled(laying, start, end) for start, end in pairwise(turns)]
    return [*stages, *rolls, resting(rolls[-1], CableState.HITCHED)]


@pytest.mark.parametrize(
    ("n", "pair", "degrees", "when"),
    [
        (3, 0, 60.0, "hold"),
        (3, 2, 0.5, "close"),
        pytest.param(3, 1, 5.0, "open", marks=pytest.mark.slow),
        pytest.param(6, 4, 20.0, "hold", marks=pytest.mark.slow),
    ],
)
def test_pairs_that_lie_across_do_not_roll_on(
    n: int, pair: int, degrees: float, when: str, tmp_path: Path
) -> None:
    """Their cables would pull on each other; every other check holds, at all times."""
    motions = past(n, pair, degrees, when)
    certificate = certify(concatenated(motions), reports=())
    assert [check.name for check in certificate.violated] == ["interlacing"]
    assert wrong(motions) == {f"p{pair}"}
    opinion = second_opinion(motions, tmp_path, *(() if n == 6 else (ORDER,)))
    assert f"p{pair} rolls past lying across" in opinion
    assert opinion.count("Row(") == 1


def test_a_roll_past_lying_across_by_less_than_balance_allows_holds(tmp_path: Path) -> None:
    motions = past(3, 1, 0.25, "hold")
    assert not wrong(motions)
    assert not second_opinion(motions, tmp_path, ORDER)


def test_no_pair_is_open_at_the_start(tmp_path: Path) -> None:
    """Curves do not show which of the cables lies on the other."""
    laying = laying_of(3)
    for roll in (laying.path.start, laying.path.start * [0.0, 1.0, 0.0]):
        shut = rolled(laying, roll, laying.path.end)
        assert wrong([shut]) == {f"p{k}" for k in np.flatnonzero(roll)}
        assert "open at the start" in second_opinion([shut], tmp_path, ORDER)


def test_upper_cables_come_from_above(tmp_path: Path) -> None:
    laying, (taut, slide, _, tension, roll) = laying_of(3), stages_of(3)
    # Cable 2, at the top, comes from below instead: it would pass through both others.
    below = replace(laying, levels=np.array([0, 1, -1]))
    under = [
        lowered(below, below.drones_outside, below.drones_above),
        lowered(below, below.drones_above, laying.drones_laid),
    ]
    assert wrong([*under, tension, roll]) == {"p0", "p2"}
    # Cables that stay 5 cm apart are not laid.
    apart = laying.drones_laid + np.repeat(0.05 * laying.levels, 2)[:, None] * [0.0, 0.0, 1.0]
    assert {"p0", "p1", "p2"} <= wrong(
        [taut, slide, lowered(laying, laying.drones_above, apart), roll]
    )
    # Cables that lie on one another are not moved aside.
    unroll, relax = reversed_stages([tension, roll])
    untied = [taut, slide, stages_of(3)[2], tension, roll, unroll, relax]
    aside = lowered(laying, laying.drones_laid, laying.drones_laid + [0.3, 0.0, 0.0])
    assert wrong([*untied, aside]) == clasps(3)
    assert "touching cables move" in second_opinion([*untied, aside], tmp_path, ORDER)
    # The lowest one is lifted first, through the others.
    path = straight_lines(laying.hitch.team, SPEC.limits, laying.drones_laid, laying.drones_above)
    down = laying.drones_laid[:2] + [0.0, 0.0, 0.9]
    up = np.concatenate([down, laying.drones_above[2:]])
    lifted = lowered(laying, laying.drones_laid, up)
    assert path.duration < lifted.duration
    assert wrong([*untied, lifted]) == {"p0", "p1"}
    assert "lifted through another one" in second_opinion([*untied, lifted], tmp_path, ORDER)


@pytest.mark.parametrize(
    ("share", "holds"), [(0.15, True), (-0.15, True), (0.3, False), (-0.3, False)]
)
def test_tensions_of_laid_cables_are_within_an_eighth(share: float, holds: bool) -> None:
    """The error of its chord is a share of its sag; tension by the catenary equation."""
    laying = laying_of(3)
    team, pairs = laying.hitch.team, laying.drones_laid.reshape(-1, 2, 3)
    sag = sag_factors(team, team.tension) * team.cable_length**2
    chords = np.linalg.norm(pairs[:, 1] - pairs[:, 0], axis=1)
    chord_lengths = team.cable_length * (1.0 - (1.0 + share) * sag)
    middle = np.mean(pairs, axis=1, keepdims=True)
    laid = (middle + (chord_lengths / chords)[:, None, None] * (pairs - middle)).reshape(-1, 3)
    up = np.array([0.0, 0.0, 0.5])
    result = row(lowered(laying, laid + up, laid), "cable_length")
    assert result.holds is holds
    half = team.cable_weight[0::2]  # of a cable's weight, which each of its ends carries
    pulls = np.hypot(half / np.sinh(steepness(team.cable_length / chord_lengths)), half)
    assert not holds or np.all(np.abs(pulls / team.tension - 1.0) < 0.125)


def test_laid_hitches_are_not_untied_by_swaps_of_the_other_sense() -> None:
    laying, stages, (_, swaps) = laying_of(3), stages_of(3), swaps_of(3)
    assert wrong([*stages, *reversed_stages(swaps)]) == {
        f"p{k}" for k in np.flatnonzero(laying.senses < 0.0)
    }
    # Lifted off, and tied by swaps, it opens in their sense.
    again = [*stages, *reversed_stages(stages), *swaps]
    opened = np.abs(laying.path.start)
    assert not wrong([*again, rolled(laying, laying.path.end, -opened)])
    assert wrong([*again, rolled(laying, laying.path.end, opened)]) == clasps(3)


def test_laying_may_pause() -> None:
    laying, stages = laying_of(3), stages_of(3)
    higher = laying.drones_outside + [0.0, 0.0, 0.2]
    hop = [
        lowered(laying, laying.drones_outside, higher),
        lowered(laying, higher, laying.drones_outside),
    ]
    parts = [stages[0], *hop, *stages[1:]]
    assert not wrong([*parts, *reversed_stages(parts)])


@cache
def erring_plan(n: int) -> ho.Plan:
    """Return the plan of a ring that is laid by drones with errors of 3 cm."""
    edge, length = RINGS[n]
    y = 1.3 * (np.arange(n) - 0.5 * (n - 1))
    q = np.column_stack([np.full(n, -0.4 * length), y, np.zeros(n)])
    return ho.form(
        q=q,
        r=q * [-1.0, 1.0, 1.0],
        team=ho.Team(n, length, tension=0.7, cable_density=0.01),
        polygon=ho.regular_polygon(n, edge, angle=0.3),
        altitude=1.5,
        by="laying",
        limits=ho.Limits(tracking=0.03),
    )


def sagging(q: np.ndarray, r: np.ndarray, depth: float) -> np.ndarray:
    """Return 60 links (…, 60, 2, 3) of cables that sag by a depth below their chords."""
    share = np.linspace(0.0, 1.0, 61)[:, None]
    points = q[..., None, :] + share * (r - q)[..., None, :]
    points[..., 2] -= (4.0 * depth * share * (1.0 - share))[:, 0]
    return np.stack([points[..., :-1, :], points[..., 1:, :]], axis=-2)


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 6])
def test_errors_of_the_certified_radius_keep_every_distance(n: int, tmp_path: Path) -> None:
    """Drones, and vertices as pairs roll, err in random directions, by the radius and less.

    Where errors would pull a cable longer than it is, it is straight.
    """
    plan = erring_plan(n)
    motion, limits = plan.motion, plan.motion.requirements.separation
    radius = plan.certificate["tracking_radius"].worst
    assert plan.certificate.certified
    assert radius >= 0.03
    assert {row.verdict for row in opinion_of(motion, tmp_path)} == {"proven"}
    names = ["draw taut", "slide in", "lay", "tension", "roll"]
    assert [each.name for each in motion.phases if each.name in names] == names
    rng, layout, drone = np.random.default_rng(n), motion.team.layout, np.arange(2 * n)
    samples = 400

    def error(count: int) -> np.ndarray:
        direction = rng.normal(size=(samples, count, 3))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return np.asarray(radius * direction * rng.choice([0.3, 1.0], size=(samples, 1, 1)))

    for phase in motion.phases:
        if phase.name not in names:
            continue
        times = np.linspace(phase.start, phase.end - 1e-9, samples)
        drones = motion.drones.at(times) + error(2 * n)
        q, r = drones[:, 0::2], drones[:, 1::2]
        i, j = np.triu_indices(2 * n, 1)
        separation = np.linalg.norm((drones[:, i] - drones[:, j]) * limits.scale, axis=-1)
        assert np.min(separation) >= 1.0
        if phase.state is ROLLING:
            places = motion.vertices.at(times) + error(n)
            p, after = places[:, layout.starts], places[:, layout.ends]
            links = np.stack([np.stack(x, axis=-2) for x in ((q, p), (p, after), (after, r))], 2)
        elif phase.state is LAYING:
            links = sagging(q, r, 0.05)
        else:
            slack = np.maximum(motion.team.cable_length - np.linalg.norm(r - q, axis=-1), 0.0)
            depth = float(np.max(np.sqrt(0.375 * slack * motion.team.cable_length)))
            links = np.concatenate([sagging(q, r, 0.0), sagging(q, r, depth)], axis=2)
        first, last = links[..., 0, :], links[..., 1, :]
        distances = point_to_segment(
            drones[:, :, None, None], first[:, None, :, :], last[:, None, :, :]
        )
        distances[:, drone, drone // 2] = np.inf
        assert np.min(distances) >= limits.cable, phase.name
        if phase.name == "slide in":  # the upper cable passes over the lower one, or beside it
            for c in range(n):
                above, below = layout.ahead[c], layout.behind[c]
                if laying_of(n).senses[c] < 0.0:
                    above, below = below, above
                lowest = np.min(links[:, above, ..., 2], axis=(1, 2))
                height = lowest - np.max(links[:, below, ..., 2], axis=(1, 2))
                ends = (x[:, k] * [1.0, 1.0, 0.0] for k in (above, below) for x in (q, r))
                beside = segment_to_segment(*ends)
                assert np.min(np.maximum(height, beside)) >= limits.crossing
