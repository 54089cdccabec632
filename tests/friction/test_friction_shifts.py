"""Where other friction than planned leaves vertices, and what room that takes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.checks.registry import TEAM_REPORTS
from hitchopt.friction.hysteresis import held_vertices
from hitchopt.friction.shifts import (
    FRICTION_SHIFT,
    REST_SHIFT,
    distances_from_ways,
    held,
    sample_times,
    with_reserve_between_samples,
)
from hitchopt.geometry.vectors import length
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase, concatenated
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import cut, prolonged
from hitchopt.planners.rests import rest_motion
from hitchopt.values import Array
from hitchopt.values.fields import with_fields
from hitchopt.verify import slides

TRIANGLE = ho.ConvexPolygon([[0.0, 0.75], [0.65, -0.375], [-0.65, -0.375]])
OUTWARD = ho.MoveVertex(0, by=np.array([0.05, 0.2]))


@cache
def slid(least: float = 0.0, *, settle: bool = True) -> Motion:
    """A triangle whose vertex moves out by 0.2 m, and over-travels."""
    team = ho.Team(3, 2.4, tension=0.5, cable_friction=(least, 0.1))
    step = OUTWARD if settle else replace(OUTWARD, settle=False)
    steps = [step, ho.Hold(1.0)]
    return ho.solve(ho.Problem(team, ho.HitchStart(TRIANGLE, 1.0), steps)).motion


def checked(motion: Motion, name: str, **kept: object) -> ho.Check:
    requirements = replace(motion.requirements, **kept)  # type: ignore[arg-type]
    flown = motion.replaced(requirements=requirements)
    return ho.certify(flown, reports=TEAM_REPORTS)[name]


def followed(motion: Motion, frictions: Array) -> tuple[Array, Array, Array]:
    """Return times (S,), vertices (S, F, points, 3) and the plan's at rest (points, 3)."""
    t = sample_times(motion, 0, motion.drones.pieces)
    dense = np.unique(np.concatenate([t, 0.5 * (t[1:] + t[:-1])]))
    found = held(motion, dense, frictions, np.zeros(len(frictions)))
    return dense, found.vertices, found.planned[-1]


def test_no_friction_of_the_range_moves_vertices_farther_than_the_certificate_says() -> None:
    motion = slid()
    shift, rest = (checked(motion, name).worst for name in ("friction_shift", "rest_shift"))
    frictions = np.array([0.013, 0.041, 0.062, 0.09])
    t, vertices, planned = followed(motion, frictions)
    ways = motion.vertices.at(np.linspace(0.0, motion.duration, 400))
    off = [distances_from_ways(places, ways) for places in vertices.swapaxes(0, 1)]
    ends = np.linalg.norm(vertices[-1] - planned, axis=-1)
    assert len(t) > 50
    assert 0.5 * shift < np.max(off) <= shift
    assert 0.5 * rest < np.max(ends) <= rest


def test_over_travels_leave_vertices_near_their_goals_for_every_friction() -> None:
    """Without them, a vertex rests farther off; with a range there is less to fear.

    The model has no swings: simulated clasps rest 1.3 cm off where it has 3 cm.
    """
    settled, left = checked(slid(), "rest_shift"), checked(slid(settle=False), "rest_shift")
    assert settled.worst < 0.04
    assert left.worst > 0.07
    assert (settled.method, settled.limit, settled.where) == ("sampled", None, ("p0",))
    shifts = [checked(slid(least, settle=False), "friction_shift").worst for least in (0.0, 0.08)]
    assert shifts[1] < shifts[0]


def test_either_limit_of_rests_refuses_vertices_that_are_held_farther_off() -> None:
    motion = slid()
    worst = checked(motion, "rest_shift").worst
    for limits, limit in (
        (ho.Limits(rest_shift=0.9 * worst), 0.9 * worst),
        (ho.Limits(vertex_error=0.8 * worst, rest_shift=1.0), 0.8 * worst),
        (ho.Limits(rest_shift=1.1 * worst), 1.1 * worst),
    ):
        check = checked(motion, "rest_shift", limits=limits)
        assert check.limit == pytest.approx(limit)
        assert check.holds == (worst <= limit)


def rest_check(motion: Motion) -> ho.Check:
    """Return the check ``rest_shift`` of a motion."""
    check = REST_SHIFT.check(motion, {}, 1.0)
    assert check is not None
    return check


def rest_row(motion: Motion, folder: Path) -> verify.Row:
    """Return the verifier's row ``rest_shift`` of a motion."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion))
    (own,), _ = verify.read(folder / "plan.npz")
    (row,) = slides.rest_shifts(own)
    return row


@pytest.mark.parametrize("seconds", [0.0, 1e-3, 0.4])
def test_a_rest_counts_however_short_and_so_does_the_end(seconds: float, tmp_path: Path) -> None:
    """Before over-travels, too; they follow a slide without a rest."""
    whole, slide = slid(), int(np.sum(slid().phase_of_piece == 0))
    limits = replace(whole.requirements, limits=ho.Limits(rest_shift=0.04))
    motion = whole.replaced(requirements=limits)
    ends = prolonged(cut(motion, 0, slide), seconds)
    check, row = rest_check(ends), rest_row(ends, tmp_path)
    assert (check.holds, row.verdict) == (False, "violated")
    assert check.worst > 0.07
    assert row.worst == pytest.approx(check.worst, rel=0.1)
    assert row.time == check.time == ends.duration
    settled = rest_check(concatenated([ends, cut(motion, slide, motion.drones.pieces)]))
    assert settled.holds is (seconds == 0.0)
    assert (settled.time == ends.duration) is (seconds > 0.0)


def tied(tension: list[float]) -> Motion:
    """Return a triangle at rest, whose cables were tightened before."""
    team = ho.Team(3, 2.4, tension=tension, cable_friction=(0.05, 0.1))
    hitch = ho.Hitch.spread(team, TRIANGLE, altitude=1.0)
    limits = Requirements(limits=ho.Limits(rest_shift=1.0))
    motion = prolonged(rest_motion(hitch, limits, 1.0, Phase("tighten", 0, 0.0, 1.0)), 1.0)
    tight, hitched = (motion.phases[0].retimed(*span) for span in ((0.0, 1.0), (1.0, 2.0)))
    return motion.replaced(phases=(replace(tight, state=CableState.TIGHTENING), hitched))


def test_a_hitch_that_was_tied_has_friction_in_both_directions_at_first(tmp_path: Path) -> None:
    """One that a plan starts with has none."""
    motion = tied([0.5, 0.45, 0.55])
    check, row = rest_check(motion), rest_row(motion, tmp_path)
    frictions = np.linspace(0.05, 0.1, 5)
    ends = [
        length(found.vertices[-1] - found.planned[-1])
        for share in (-1.0, 1.0)
        for found in [held(motion, np.array([1.0, 2.0]), frictions, np.full(5, share))]
    ]
    assert min(map(np.max, ends)) > 0.005
    assert max(map(np.max, ends)) <= check.worst < 1.3 * max(map(np.max, ends))
    assert row.worst == pytest.approx(check.worst, rel=0.05)
    at_start = motion.replaced(phases=(replace(motion.phases[1], start=0.0),))
    assert rest_check(at_start).worst < 1e-3
    assert rest_row(at_start, tmp_path).worst < 1e-3


def test_a_limit_of_rests_refuses_a_plan_for_its_end_but_no_step_before_its_over_travels() -> None:
    team = ho.Team(3, 2.4, tension=0.5, cable_friction=0.1)
    start, limits = ho.HitchStart(TRIANGLE, 1.0), ho.Limits(rest_shift=0.045)
    settled = ho.solve(ho.Problem(team, start, [OUTWARD], limits=limits))
    assert settled.certificate["rest_shift"].holds
    with pytest.raises(ho.InfeasibleError, match="rest_shift"):
        ho.solve(ho.Problem(team, start, [replace(OUTWARD, settle=False)], limits=limits))


def test_a_limit_of_rests_without_any_has_nothing_to_check(tmp_path: Path) -> None:
    """Where there is no friction, or no hitch without a load."""
    motion = slid()
    limits = replace(motion.requirements, limits=ho.Limits(vertex_error=0.04))
    smooth = with_fields(motion.team, cable_friction=0.0)
    flown = motion.replaced(team=smooth, requirements=limits)
    check, row = rest_check(flown), rest_row(flown, tmp_path)
    assert (check.holds, check.is_evaluated, check.row["where"]) == (
        True,
        False,
        "nothing to check",
    )
    assert (row.verdict, row.samples) == ("nothing to check", 0)
    assert np.isnan(row.worst)
    assert verify.verdict([row]).endswith("; nothing to check: rest_shift")


def test_shifts_take_room_from_walls_and_objects() -> None:
    motion = slid()
    free = checked(motion, "friction_shift")
    assert (free.limit, free.holds, free.method) == (None, True, "sampled")
    t = np.linspace(0.0, motion.duration, 4_000)
    lowest = float(np.min(motion.vertices.at(t)[..., 1]))
    for room, holds in ((1.05 * free.worst, True), (0.5 * free.worst, False)):
        arena = ho.Arena([-9.0, lowest - 0.5 * room, 0.0], [9.0, 9.0, 9.0])
        walled = checked(motion, "friction_shift", arena=arena)
        assert walled.limit == pytest.approx(0.5 * room, abs=2e-3)
        beyond = replace(arena, lower=arena.lower - [0.0, 0.5 * room, 0.0])
        walled = checked(motion, "friction_shift", arena=beyond)
        assert walled.limit == pytest.approx(room, abs=2e-3)
        assert walled.binding == "arena"
        assert walled.holds == (walled.worst <= walled.number)
        assert holds == walled.holds


def test_a_shift_without_a_balance_is_infinite_and_others_keep_their_reserve() -> None:
    shifts = with_reserve_between_samples(
        np.array([[np.inf, np.inf], [1.0, 3.0], [2.0, 2.0]]), (1,)
    )
    np.testing.assert_array_equal(shifts, [[np.inf, np.inf], [1.5, 3.5], [2.0, 2.0]])


def test_a_course_is_followed_once_wherever_a_plan_flies_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steps and whole plans share it."""
    motion = slid()
    start = ho.HitchStart(TRIANGLE, 1.0)
    rest = ho.solve(ho.Problem(motion.team, start, [ho.Hold(np.pi / 3.0)])).motion
    followed = list[Array]()

    def counted(*arguments: Any) -> Array:
        followed.append(held_vertices(*arguments))
        return followed[-1]

    def shift(flown: Motion) -> ho.Check:
        return ho.certify(flown, reports=(FRICTION_SHIFT,))["friction_shift"]

    alone = shift(motion)
    monkeypatch.setattr("hitchopt.friction.shifts.held_vertices", counted)
    joined = shift(concatenated([rest, motion]))
    assert joined.worst == pytest.approx(alone.worst, rel=1e-12)
    assert joined.time == pytest.approx(alone.time + rest.duration)
    slower = shift(motion.slowed(1.1))  # friction does not depend on speeds
    assert slower.worst == pytest.approx(alone.worst, rel=1e-6)
    assert followed == []
    least = with_fields(motion.team, cable_friction=(0.01, 0.1))
    assert shift(motion.replaced(team=least)).worst <= (1.0 + 1e-6) * alone.worst
    assert len(followed) == 2


def test_only_over_travels_need_room() -> None:
    """A vertex that moves to another place lags behind its plan: nothing limits that."""
    motion = slid(settle=False)
    lowest = float(np.min(motion.vertices.at(np.linspace(0.0, motion.duration, 999))[..., 1]))
    arena = ho.Arena([-9.0, lowest - 1e-3, 0.0], [9.0, 9.0, 9.0])
    check = checked(motion, "friction_shift", arena=arena)
    assert check.worst > 0.01
    assert (check.limit, check.holds) == (None, True)


def test_the_verifier_finds_the_same(tmp_path: Path) -> None:
    """By its own statics, frictions and samples; rests jump by millimetres between frictions."""
    motion = slid()
    error = ho.Limits(vertex_error=1.0)
    arena = ho.Arena([-9.0, -9.0, 0.9], [9.0, 9.0, 9.0])
    requirements = replace(motion.requirements, limits=error, arena=arena)
    flown = motion.replaced(requirements=requirements)
    certificate = ho.certify(flown)
    ho.Plan(ho.Flight.of(flown), certificate).save(tmp_path)
    rows = {row.name: row for row in verify.verify(tmp_path / "plan.npz")}
    for name, near in (("friction_shift", 0.2), ("rest_shift", 0.1)):
        row, check = rows[name], certificate[name]
        assert row.worst == pytest.approx(check.worst, rel=near)
        assert row.limit == pytest.approx(check.limit, rel=1e-3)
        assert row.verdict == "at samples"
    assert "only at samples: friction_shift, rest_shift" in verify.verdict(list(rows.values()))
