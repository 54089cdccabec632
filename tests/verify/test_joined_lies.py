"""Robots that join a hitch in flight, and leave it: lies about rings, seams and who is on top."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain, combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from plans import planned

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.joining import interlaced, jumps_of_thrust, lowered_over
from hitchopt.checks.registry import RULE_OF, check_of
from hitchopt.errors import FileError
from hitchopt.hitch import Hitch
from hitchopt.hitch.team import PartTeam
from hitchopt.motion.chapters import chapters, with_waiting
from hitchopt.motion.motion import CableState, Motion, Phase, joined_motions
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.motion.retiming import shifted
from hitchopt.planners.forming.joining import Joining
from hitchopt.planners.forming.laying import rolling

Flags = NDArray[np.bool_]
Change = Callable[[Motion], Motion]
REFUSED = "refused"
"""The file cannot be read as a plan."""

LYING, ROLLING = CableState.LYING, CableState.ROLLING
BEFORE, WITH, AFTER = (0, 1, 2), (3, 0, 1, 2), (0, 1, 2)


def honest() -> Motion:
    return planned("join_a_fourth").motion


def at(motion: Motion, names: tuple[str, ...], ring: tuple[int, ...] | None = None) -> Flags:
    """Which pieces are in phases of these names, of step 1 or later."""
    good = [p.name in names and p.step > 0 and ring in (None, p.ring) for p in motion.phases]
    found: Flags = np.array(good)[motion.phase_of_piece]
    return found


def told(change: Callable[[Phase], Phase]) -> Change:
    """Say something else of phases."""
    return lambda motion: motion.replaced(phases=tuple(map(change, motion.phases)))


def called(name: str, **values: object) -> Change:
    """Say something else of the phases of a name, of step 1 or later."""
    return told(lambda p: replace(p, **values) if p.name == name and p.step else p)  # type: ignore[arg-type]


def waits(name: str, state: CableState) -> Change:
    """Say something else of robot 3 as it waits."""
    return called(name, waiting=((3, state),))


def ringed(old: tuple[int, ...], new: tuple[int, ...], waiting: tuple[int, ...] = ()) -> Change:
    """Say that others form a ring."""
    rest = tuple((k, CableState.FREE) for k in waiting)
    return told(lambda p: replace(p, ring=new, waiting=rest or p.waiting) if p.ring == old else p)


def edited(curve: str, change: Callable[[Motion, NDArray[np.float64]], object]) -> Change:
    """Edit the coefficients of a curve in place."""

    def edit(motion: Motion) -> Motion:
        own = getattr(motion, curve)
        c = own.coefficients.copy()
        change(motion, c)
        return motion.replaced(**{curve: own.alike(c)})

    return edit


def moved(names: tuple[str, ...], drones: slice, by: float, axis: int = 2) -> Change:
    """Move drones in some phases [m]."""

    def edit(motion: Motion, c: NDArray[np.float64]) -> None:
        c[at(motion, names), drones, axis] += by

    return edited("drones", edit)


def mirrored(name: str, end: int) -> Change:
    """Let robot 3 come from as far below, or go there, as it does from above."""

    def edit(motion: Motion, c: NDArray[np.float64]) -> None:
        on = np.flatnonzero(at(motion, (name,)))
        lies = c[on[end], 6:8, 2, end]
        c[on, 6:8, 2] = 2.0 * lies[:, None] - c[on, 6:8, 2]

    return edited("drones", edit)


def dipped(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the q-leg of cable 0 rise and dip through the r-leg of cable 2 as pairs begin to roll."""
    on = np.flatnonzero(at(motion, ("roll",), WITH))
    c[on[:20], 0, 2, 1:-1] += 0.3
    c[on[20:40], 0, 2, 1:-1] -= 0.3


def slid(motion: Motion) -> Motion:
    """Let cable 1 slide by 3 cm and back as weight passes."""
    on = np.flatnonzero(at(motion, ("pass weight",), WITH))[1:3]
    drones, legs = motion.drones.coefficients.copy(), motion.legs.coefficients.copy()
    own = drones[on[0], 2:4, :, 0] - motion.vertices.coefficients[on[0], 2:4, :, 0]
    for sign, drone, way in zip((1.0, -1.0), (2, 3), own, strict=True):
        along = sign * 0.03 * way / np.linalg.norm(way)
        drones[on[0], drone, :, 1:] += along[:, None]
        drones[on[1], drone, :, :-1] += along[:, None]
        legs[on[0], 1, drone - 2, 1:] += sign * 0.03
        legs[on[1], 1, drone - 2, :-1] += sign * 0.03
    return motion.replaced(drones=motion.drones.alike(drones), legs=motion.legs.alike(legs))


def drifted(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the vertex of cables 0 and 1 be elsewhere from the seam on, by less than lengths tell."""
    ring = np.array([p.ring == WITH for p in motion.phases])[motion.phase_of_piece]
    c[ring, 2, 0] += 1e-5


def pulled(motion: Motion, c: NDArray[np.float64]) -> None:
    c[at(motion, ("climb",)), 3] = 0.7


def more(motion: Motion, c: NDArray[np.float64]) -> None:
    c[at(motion, ("climb",)), 3] = 0.7


def longer(share: float) -> Change:
    """Say that cable 3 has another length."""

    def change(motion: Motion) -> Motion:
        length = motion.team.cable_length * np.array([1.0, 1.0, 1.0, share])
        return motion.replaced(team=replace(motion.team, cable_length=length))

    return change


def until(name: str) -> Change:
    """End as a phase of step 1 does."""

    def change(motion: Motion) -> Motion:
        last = next(i for i, p in enumerate(motion.phases) if p.name == name and p.step == 1)
        stop = int(np.flatnonzero(motion.phase_of_piece == last)[-1]) + 1
        return motion.slice_pieces(slice(0, stop), motion.phases[: last + 1])

    return change


def jumped(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let a drone be elsewhere as long as robot 3 is in the ring."""
    c[np.array([p.ring == WITH for p in motion.phases])[motion.phase_of_piece], 0, 2] += 1e-5


def since(name: str) -> Change:
    """Begin as a phase of step 1 does."""

    def change(motion: Motion) -> Motion:
        first = next(i for i, p in enumerate(motion.phases) if p.name == name and p.step == 1)
        start = int(np.flatnonzero(motion.phase_of_piece == first)[0])
        rest = motion.slice_pieces(slice(start, None), motion.phases[first:])
        return shifted(rest, -float(rest.drones.breaks[0]))

    return change


def aside(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let robot 3 come down with a sideways motion."""
    on = np.flatnonzero(at(motion, ("lower",)))
    c[on[-3:-1], 6:8, 1, 2:-2] += 0.01


def other_leg_first(motion: Motion) -> Motion:
    """Roll the other one of both new pairs first."""
    rolls = [i for i, p in enumerate(motion.phases) if p.name == "roll" and p.ring == WITH]
    pieces = [np.flatnonzero(motion.phase_of_piece == i) for i in rolls]
    ring = chapters(motion)[1]
    breaks, c = ring.drones.breaks, ring.drones.coefficients
    half, k = (int(np.argmax(breaks[:-1] > motion.phases[i].end - 1e-6)) for i in rolls)
    points = ring.vertices.coefficients[k, ..., 0]
    q_legs = ring.legs.coefficients[k, :, 0, 0]
    outline = ho.ConvexPolygon(points[:, :2])
    hitch = Hitch(PartTeam.of(motion.team, WITH), outline, float(points[0, 2]), q_legs, np.zeros(4))
    both = [Joining(hitch, hitch, 0, sign * np.ones(3), 1.0).rolls for sign in (-1.0, 1.0)]
    off = [np.max(np.abs(x[0].drones(np.ones(1))[0] - c[half, ..., 0])) for x in both]
    assert min(off) < 0.01 < max(off)
    wrong = both[int(np.argmax(off))]
    parts = [
        with_waiting(
            rolling(path, motion.requirements, Phase("roll", 1, 0.0, 0.0)),
            motion.team,
            {},
            motion.requirements,
        )
        for path in wrong
    ]
    before = motion.slice_pieces(slice(0, int(pieces[0][0])), motion.phases[: rolls[0]])
    rest = slice(int(pieces[-1][-1]) + 1, None)
    after = motion.slice_pieces(rest, motion.phases[rolls[-1] + 1 :])
    return joined_motions([before, *parts, shifted(after, -float(after.drones.breaks[0]))])


LIES: dict[str, tuple[Change, str, str]] = {
    # Rings.
    "two cables change places in the ring": (ringed(WITH, (3, 1, 0, 2)), "interlacing", "interlacing"),
    "another robot joined": (ringed(WITH, (2, 0, 1, 3)), "interlacing", "interlacing"),
    "the robot is in the ring at another vertex": (ringed(WITH, (0, 3, 1, 2)), "interlacing", "interlacing"),
    "a robot is in no ring and waits nowhere": (ringed(WITH, (0, 1, 2)), REFUSED, REFUSED),
    "a robot is in the ring and waits": (ringed(WITH, WITH, (3,)), REFUSED, REFUSED),
    "a ring of two": (ringed(BEFORE, (0, 1), (2, 3)), REFUSED, REFUSED),
    # Who waits, and how.
    "it is clasped as it waits": (waits("climb", CableState.CLASPING), REFUSED, REFUSED),
    "it climbs on the ground": (waits("climb", CableState.GROUND), "interlacing", "story"),
    "it hangs where it is taut": (waits("lower", CableState.FREE), "crossing", "crossing"),
    "it is taut where it hangs": (waits("approach", CableState.LAYING), "cable_length", "cable_length"),
    "it pulls as it waits": (edited("tensions", pulled), REFUSED, "story"),
    "there is a vertex too many": (edited("vertices", more), REFUSED, REFUSED),
    "its cable is longer": (longer(1.01), "cable_length", "cable_length"),
    "its cable is shorter": (longer(0.99), "cable_length", "cable_length"),
    # Seams.
    "it jumps as it joins": (moved(("pass weight",), slice(6, 7), 1e-5), "continuity", "continuity"),
    "a drone jumps at both seams": (edited("drones", jumped), "continuity", "continuity"),
    "a cable slides as weight passes": (slid, "interlacing", "interlacing|contact"),
    "a vertex that stays is elsewhere": (edited("vertices", drifted), "interlacing", "interlacing"),
    "it is tied as it lies": (called("pass weight", state=ROLLING), "interlacing", "interlacing"),
    "it stays on top without joining": (until("lower"), "interlacing", "crossing"),
    "it lies there as the plan begins": (since("pass weight"), "interlacing", "interlacing|story"),
    # Who lies on whom.
    "it comes down sideways": (edited("drones", aside), "crossing", "crossing"),
    "it comes from below": (mirrored("lower", -1), "interlacing", "interlacing"),
    "it goes down through the hitch": (mirrored("raise", 0), "interlacing", "interlacing"),
    "it lies 5 cm aside": (moved(("lower",), slice(6, 8), 0.05, 1), "interlacing", "interlacing"),
    "it lies 5 cm above": (moved(("lower",), slice(6, 8), 0.05), "interlacing", "interlacing"),
    "the leg below lies on top": (moved(("pass weight", "roll"), slice(0, 1), 0.15), "interlacing", "interlacing"),
    "a leg passes through the other one": (edited("drones", dipped), "interlacing", "laid"),
    "the wrong leg rolls first": (other_leg_first, "interlacing", "interlacing"),
    # Passing weight.
    "it passes weight as it holds": (called("hold", state=LYING), "interlacing", "interlacing|story"),
    "it passes weight as it climbs": (called("climb", state=LYING), "interlacing", "story"),
    "it passes weight as it rolls": (called("roll", state=LYING), "interlacing", "story"),
}  # fmt: skip


def second_opinion(path: Path, limits: list[str]) -> Iterator[second.Row]:
    """Yield the rows of limits alone, which is sooner."""
    (whole,), _ = second.read(path)
    parts = [*chain(*whole.chapters)]
    if "interlacing" in limits:
        yield from second.interlacing(whole)
    if "continuity" in limits:
        yield from second.jumps(whole)
    if "story" in limits:
        yield from chain(*map(second.story, parts))
    if "laid" in limits:
        yield from chain(*map(second.cut_legs, parts))
    if "cable_length" in limits:
        for part in parts:
            yield from second.taut_cables(part) if part.n > 1 else second.laid_cables(part)
    if "crossing" in limits:
        for chapter in whole.chapters:
            for p, q in combinations(chapter, 2):
                yield from second.across(second.Pair(p, q, p.settings["separation"], 0.0))


@pytest.mark.parametrize("name", LIES)
def test_lies_are_refused_by_both_opinions(name: str, tmp_path: Path) -> None:
    change, first, other = LIES[name]
    path = tmp_path / "plan.npz"
    write_plan(path, change(honest()))
    if first == REFUSED:
        with pytest.raises((ho.InputError, FileError)):
            read_plan(path)
    else:
        motion = read_plan(path)
        interlacing = first == "interlacing"
        check = None if interlacing else check_of(RULE_OF[first], motion)
        assert interlaced(chapters(motion)).worst if check is None else not check.holds
    if other == REFUSED:
        with pytest.raises(second.UnreadableError):
            second.read(path)
    else:
        limits = other.split("|")
        assert any(
            row.name in limits and row.verdict == "violated" for row in second_opinion(path, limits)
        )


def test_the_truth_is_told_by_the_same_rows(tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    write_plan(path, honest())
    motion = read_plan(path)
    assert not interlaced(chapters(motion)).worst
    limits = ["interlacing", "continuity", "story", "laid", "crossing"]
    rows = [row for row in second_opinion(path, limits) if row.samples]
    assert {row.verdict for row in rows} == {"proven"}
    assert {*limits} <= {row.name for row in rows}


def test_nothing_passes_weight_in_a_plan_of_the_same_robots(tmp_path: Path) -> None:
    motion = planned("triangle").motion
    lie = told(lambda p: replace(p, state=LYING))(motion)
    assert not check_of(RULE_OF["interlacing"], lie).holds  # type: ignore[union-attr]
    write_plan(tmp_path / "plan.npz", lie)
    (whole,), _ = second.read(tmp_path / "plan.npz")
    assert {row.verdict for row in second.story(whole) if row.name == "story"} == {"violated"}


def test_edges_of_a_ring_that_moves_are_kept_off() -> None:
    ring, alone = (group.motion for group in chapters(honest())[0].groups)
    assert [*lowered_over(ring, alone)]
    away = ring.vertices.coefficients + np.linspace(0.0, 1e-3, ring.vertices.degree + 1)
    moving = ring.replaced(vertices=ring.vertices.alike(away))
    assert not [*lowered_over(moving, alone)]


def test_thrusts_jump_at_seams_by_less_than_a_cable_weighs() -> None:
    motion = honest()
    assert jumps_of_thrust(motion, chapters(motion)).worst == 0.0
    light = motion.replaced(team=replace(motion.team, cable_density=1e-6))
    found = jumps_of_thrust(light, chapters(motion))
    assert 1e-3 < found.worst < np.max(motion.team.cable_weight) * 2.0
    assert found.time in {float(each.drones.breaks[0]) for each in chapters(motion)[1:]}
