"""Robots that join a hitch in flight, and leave it: lies about rings, seams and who is on top."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from groups import joining, leaving
from numpy.typing import NDArray
from plans import planned
from second_opinions import ROWS, opinion

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks import ring_change
from hitchopt.checks.registry import RULE_OF, check_of
from hitchopt.checks.ring_change import interlacing, vertical_passes
from hitchopt.errors import FileError
from hitchopt.hitch import GRAVITY, Hitch
from hitchopt.hitch.team import PartTeam
from hitchopt.motion.chapters import chapters, with_waiting
from hitchopt.motion.motion import CableState, Motion, Phase, concatenated
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.motion.retiming import shifted
from hitchopt.planners.forming.laying import roll_motion
from hitchopt.planners.forming.ring_change import RingChange

Flags = NDArray[np.bool_]
Change = Callable[[Motion], Motion]
REFUSED = "refused"
"""The file cannot be read as a plan."""

GROUND, FREE, CLASPING = CableState.GROUND, CableState.FREE, CableState.CLASPING
HITCHED, LAYING = CableState.HITCHED, CableState.LAYING
LYING, ROLLING = CableState.LYING, CableState.ROLLING
BEFORE, WITH, AFTER = (0, 1, 2), (3, 0, 1, 2), (0, 1, 2)


def at(motion: Motion, names: tuple[str, ...], ring: tuple[int, ...] | None = None) -> Flags:
    """Which pieces are in phases of these names, of step 1 or later."""
    good = [p.name in names and p.step > 0 and ring in (None, p.ring) for p in motion.phases]
    found: Flags = np.array(good)[motion.phase_of_piece]
    return found


def pieces(motion: Motion, name: str) -> NDArray[np.intp]:
    """Which pieces are in the phases of a name."""
    return np.flatnonzero(np.array([p.name == name for p in motion.phases])[motion.phase_of_piece])


def told(change: Callable[[Phase], Phase]) -> Change:
    """Say something else of phases."""
    return lambda motion: motion.replaced(phases=tuple(map(change, motion.phases)))


def called(name: str, **values: object) -> Change:
    """Say something else of the phases of a name, of step 1 or later."""
    return told(lambda p: replace(p, **values) if p.name == name and p.step else p)  # type: ignore[arg-type]


def named(name: str, state: CableState) -> Change:
    """Say another state of the phases of a name."""
    return told(lambda p: replace(p, state=state) if p.name == name else p)


def waits(name: str, state: CableState) -> Change:
    """Say something else of robot 3 as it waits."""
    return called(name, waiting=((3, state),))


def ringed(old: tuple[int, ...], new: tuple[int, ...], waiting: tuple[int, ...] = ()) -> Change:
    """Say that others form a ring."""
    rest = tuple((k, FREE) for k in waiting)
    return told(lambda p: replace(p, ring=new, waiting=rest or p.waiting) if p.ring == old else p)


def at_first(*values: dict[str, object]) -> Change:
    """Say something else of the first phases, one after the other."""

    def change(motion: Motion) -> Motion:
        rows = chain(values, ({} for _ in motion.phases[len(values) :]))
        said = (replace(p, **row) for p, row in zip(motion.phases, rows, strict=True))  # type: ignore[arg-type]
        return motion.replaced(phases=tuple(said))

    return change


def turned(motion: Motion) -> Motion:
    """Begin the ring of four at its second robot, and its vertices there."""
    c = motion.vertices.coefficients.copy()
    ring = np.array([p.ring == WITH for p in motion.phases])[motion.phase_of_piece]
    c[ring] = np.roll(c[ring], -1, axis=1)
    told_so = motion.replaced(vertices=motion.vertices.replaced(c))
    return ringed(WITH, (*WITH[1:], WITH[0]))(told_so)


def edited(curve: str, change: Callable[[Motion, NDArray[np.float64]], object]) -> Change:
    """Edit the coefficients of a curve in place."""

    def edit(motion: Motion) -> Motion:
        own = getattr(motion, curve)
        c = own.coefficients.copy()
        change(motion, c)
        return motion.replaced(**{curve: own.replaced(c)})

    return edit


def moved(names: tuple[str, ...], drones: slice, by: float, axis: int = 2) -> Change:
    """Move drones in some phases [m]."""

    def edit(motion: Motion, c: NDArray[np.float64]) -> None:
        c[at(motion, names), drones, axis] += by

    return edited("drones", edit)


def within(name: str, curve: str, where: tuple[Any, ...], by: float) -> Change:
    """Add to coefficients of a curve on the piece in the middle of a phase, or of its pieces."""

    def edit(motion: Motion, c: NDArray[np.float64]) -> None:
        on = pieces(motion, name)
        c[(on[len(on) // 2], *where)] += by

    return edited(curve, edit)


def risen(name: str, end: int, share: float = -1.0, less: float = 0.0) -> Change:
    """Let robot 3 come from a share of its height, or go there: below where it is negative.

    Lower in all of it by so much [m].
    """

    def edit(motion: Motion, c: NDArray[np.float64]) -> None:
        on = np.flatnonzero(at(motion, (name,)))
        lies = c[on[end], 6:8, 2, end][:, None] * np.ones(c.shape[-1])
        c[on, 6:8, 2] = lies + share * (c[on, 6:8, 2] - lies) - less

    return edited("drones", edit)


def dipped(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the q-leg of cable 0 rise and dip through the r-leg of cable 2 as pairs begin to roll."""
    on = np.flatnonzero(at(motion, ("roll",), WITH))
    c[on[:20], 0, 2, 1:-1] += 0.3
    c[on[20:40], 0, 2, 1:-1] -= 0.3


def slid(name: str, by: float) -> Change:
    """Let cable 1 slide along itself [m] in a phase, and back."""

    def change(motion: Motion) -> Motion:
        on = pieces(motion, name)[1:3]
        ring = motion.phases[motion.phase_of_piece[on[0]]].ring or (0, 1, 2)
        drones, legs = motion.drones.coefficients.copy(), motion.legs.coefficients.copy()
        ends = np.array([0, 1]) + ring.index(1)
        own = drones[on[0], 2:4, :, 0] - motion.vertices.coefficients[on[0], ends, :, 0]
        for sign, drone, way in zip((by, -by), (2, 3), own, strict=True):
            along = sign * way / np.linalg.norm(way)
            for piece, where in zip(on, (np.s_[1:], np.s_[:-1]), strict=True):
                drones[piece, drone, :, where] += along[:, None]
                legs[piece, 1, drone - 2, where] += sign
        return motion.replaced(
            drones=motion.drones.replaced(drones), legs=motion.legs.replaced(legs)
        )

    return change


def reordered(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the top cable come down first, and the lowest one last."""
    on = np.concatenate([pieces(motion, name) for name in ("slide in", "lay")])[:, None]
    end = c[on[-1, 0], :6, 2, -1][:, None]
    c[on, range(6), 2] = end + (c[on, range(6), 2] - end)[:, [4, 5, 2, 3, 0, 1]]


def too_low(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let cables slide in a centimetre over each other."""
    on = np.concatenate([pieces(motion, name) for name in ("slide in", "lay")])
    end = c[on[-1], :6, 2, -1][:, None]
    c[on, :6, 2] = end + 0.02 * (c[on, :6, 2] - end)


def too_far(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let cable 0 be laid beyond one of the others."""
    on = np.concatenate([pieces(motion, name) for name in ("slide in", "lay")])
    along = c[on[-1], 1, :, -1] - c[on[-1], 0, :, -1]
    c[on, :2] += 0.3 * along[:, None]


def rolled_back(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the pair at a vertex roll in the other sense."""
    on = pieces(motion, "roll")[:, None]
    c[on, [0, 5], 2] = 2.0 * c[on[-1], [0, 5], 2, -1][:, None] - c[on, [0, 5], 2]


def pulled_more(motion: Motion) -> Motion:
    pulls = np.repeat(1.001 * motion.tensions.coefficients[:, :, None], 2, axis=2)
    return motion.replaced(leg_tensions=motion.tensions.replaced(pulls))


def teamed(**values: object) -> Change:
    """Say something else of the team."""
    return lambda motion: motion.replaced(team=replace(motion.team, **values))  # type: ignore[arg-type]


def drifted(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the vertex of cables 0 and 1 be elsewhere from the seam on, by less than lengths tell."""
    ring = np.array([p.ring == WITH for p in motion.phases])[motion.phase_of_piece]
    c[ring, 2, 0] += 1e-5


def drifted_back(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the vertex of cables 1 and 2 be elsewhere once robot 3 has left."""
    c[
        np.array([p.step == 3 and p.ring == AFTER for p in motion.phases])[motion.phase_of_piece],
        2,
        0,
    ] += 1e-5


def slipping(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let robot 3 go sideways in the last piece before it lies, and back."""
    c[np.flatnonzero(at(motion, ("lower",)))[-1], 6:8, 1, 2:-2] += 0.005


def rolled_over(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let both new pairs roll in the other sense."""
    on = np.flatnonzero(at(motion, ("roll",), WITH))[:, None]
    last = c[on[-1], [0, 5, 6, 7], 2, -1]
    c[on, [0, 5, 6, 7], 2] = 2.0 * last[..., None] - c[on, [0, 5, 6, 7], 2]


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


def past(name: str, drones: tuple[int, int], by: float) -> Change:
    """Let a pair that lies across roll, and back, within a piece of a phase: q up, r down."""

    def edit(motion: Motion, c: NDArray[np.float64]) -> None:
        on = pieces(motion, name)
        c[on[len(on) // 2], [*drones], 2, 2:-2] += [[by], [-by]]

    return edited("drones", edit)


def upended(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the q-leg of cable 1 stand upright as weight passes."""
    on = pieces(motion, "pass weight")
    place = motion.vertices.coefficients[on[0], 2, :, 0]
    c[on, 2] = (place + [0.0, 0.0, np.linalg.norm(c[on[0], 2, :, 0] - place)])[:, None]


def reaching(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let the q-leg of cable 2 reach to 3 cm over the q end of cable 3 as that comes down."""
    on = pieces(motion, "lower")
    c[on, 4] = (c[on[-1], 6, :, -1] + [0.0, 0.0, 0.03])[:, None]


def hovering(motion: Motion) -> Motion:
    """End as robot 3 is 11 cm over an edge, but so steep that it is 4 cm beside it."""

    def tilt(motion: Motion, c: NDArray[np.float64]) -> None:
        on = pieces(motion, "lower")
        q, r = c[on[-1], 6:8, :, -1]
        middle, half = 0.5 * (q + r), 0.5 * (r - q)
        half = half * math.cos(1.2) + [0.0, 0.0, np.linalg.norm(half) * math.sin(1.2)]
        ends = np.stack([middle - half, middle + half])
        c[on, 6:8] = ends[..., None] - [[0.0], [0.0], [0.2]]

    return edited("drones", tilt)(until("lower")(motion))


def jumped(motion: Motion, c: NDArray[np.float64]) -> None:
    """Let a drone be elsewhere as long as robot 3 is in the ring."""
    c[np.array([p.ring == WITH for p in motion.phases])[motion.phase_of_piece], 0, 2] += 1e-5


def since(name: str, step: int = 1) -> Change:
    """Begin as the last phase of a name does in a step."""

    def change(motion: Motion) -> Motion:
        first = max(i for i, p in enumerate(motion.phases) if (p.name, p.step) == (name, step))
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
    both = [RingChange(hitch, hitch, 0, sign * np.ones(3), 1.0).rolls for sign in (-1.0, 1.0)]
    off = [np.max(np.abs(x[0].drones(np.ones(1))[0] - c[half, ..., 0])) for x in both]
    assert min(off) < 0.01 < max(off)
    wrong = both[int(np.argmax(off))]
    parts = [
        with_waiting(
            roll_motion(path, motion.requirements, Phase("roll", 1, 0.0, 0.0)),
            motion.team,
            {},
            motion.requirements,
        )
        for path in wrong
    ]
    before = motion.slice_pieces(slice(0, int(pieces[0][0])), motion.phases[: rolls[0]])
    rest = slice(int(pieces[-1][-1]) + 1, None)
    after = motion.slice_pieces(rest, motion.phases[rolls[-1] + 1 :])
    return concatenated([before, *parts, shifted(after, -float(after.drones.breaks[0]))])


JOINING: dict[str, tuple[Change, str, str]] = {
    # Rings.
    "two cables change places in the ring": (ringed(WITH, (3, 1, 0, 2)), "interlacing", "interlacing"),
    "another robot joined": (ringed(WITH, (2, 0, 1, 3)), "interlacing", "interlacing"),
    "the robot is in the ring at another vertex": (ringed(WITH, (0, 3, 1, 2)), "interlacing", "interlacing"),
    "a robot is in no ring and waits nowhere": (ringed(WITH, (0, 1, 2)), REFUSED, REFUSED),
    "a robot is in the ring and waits": (ringed(WITH, WITH, (3,)), REFUSED, REFUSED),
    "a ring of two": (ringed(BEFORE, (0, 1), (2, 3)), REFUSED, REFUSED),
    "the ring is told backwards": (ringed(WITH, WITH[::-1]), "interlacing", "interlacing"),
    "the others change places before it joins": (told(lambda p: replace(p, ring=(1, 0, 2)) if p.ring == BEFORE and p.step == 1 else p), "interlacing", "interlacing"),
    # Who waits, and how.
    "it is clasped as it waits": (waits("climb", CLASPING), REFUSED, REFUSED),
    "it climbs on the ground": (waits("climb", GROUND), "interlacing", "consistency"),
    "it hangs where it is taut": (waits("lower", FREE), "crossing", "crossing"),
    "it is taut where it hangs": (waits("approach", LAYING), "cable_length", "cable_length"),
    "it lies on the ground where it hangs": (waits("approach", GROUND), "interlacing", "consistency"),
    "it is taut as others form the ring": (at_first({"ring": (1, 2, 0)}, {"waiting": ((3, LAYING),)}), "interlacing", "interlacing"),
    "it pulls as it waits": (edited("tensions", pulled), REFUSED, "consistency"),
    "there is a vertex too many": (edited("vertices", more), REFUSED, REFUSED),
    "its cable is longer": (longer(1.01), "cable_length", "cable_length"),
    "its cable is shorter": (longer(0.99), "cable_length", "cable_length"),
    # What the others do meanwhile.
    "they hold with an open pair": (called("climb", state=HITCHED), "equilibrium", "interlacing"),
    "they hang free": (called("climb", state=FREE), "interlacing", "interlacing"),
    "they are laid": (called("climb", state=LAYING), "interlacing", "interlacing"),
    "they are clasped as they roll": (called("roll", state=CLASPING), "interlacing", "interlacing"),
    "a drone of theirs goes around within a piece": (within("climb", "drones", np.s_[2, 2, 2:-2], 2.0), "interlacing", "interlacing"),
    "a vertex of theirs moves": (within("climb", "vertices", (0, 0, 3), 1e-3), "interlacing", "consistency"),
    # Seams.
    "it jumps as it joins": (moved(("pass weight",), slice(6, 7), 1e-5), "continuity", "continuity"),
    "a drone jumps at both seams": (edited("drones", jumped), "continuity", "continuity"),
    "a cable slides as weight passes": (slid("pass weight", 0.03), "interlacing", "interlacing|contact"),
    "a vertex that stays is elsewhere": (edited("vertices", drifted), "interlacing", "interlacing"),
    "it is tied as it lies": (called("pass weight", state=ROLLING), "interlacing", "interlacing"),
    "it stays on top without joining": (until("lower"), "interlacing", "crossing"),
    "it lies there as the plan begins": (since("pass weight"), "interlacing", "interlacing|consistency"),
    "it passes weight as the plan ends": (until("pass weight"), "interlacing", "interlacing"),
    # Who lies on whom.
    "it comes down sideways": (edited("drones", aside), "crossing", "crossing"),
    "it comes from below": (risen("lower", -1), "interlacing", "interlacing"),
    "it lies 5 cm aside": (moved(("lower",), slice(6, 8), 0.05, 1), "interlacing", "interlacing"),
    "it lies 5 cm above": (moved(("lower",), slice(6, 8), 0.05), "interlacing", "interlacing"),
    "it comes from close by": (risen("lower", -1, 0.01), "interlacing", "interlacing"),
    "it dips through the hitch": (within("lower", "drones", np.s_[6:8, 2, 2:-2], -2.0), "interlacing", "laid"),
    "it comes down on a leg": (edited("drones", reaching), "crossing", "crossing"),
    "it slips at last": (edited("drones", slipping), "interlacing", "interlacing"),
    "it hovers, but too steep to be clear": (hovering, "interlacing", "crossing"),
    "the leg below lies on top": (moved(("pass weight", "roll"), slice(0, 1), 0.15), "interlacing", "interlacing"),
    "a leg passes through the other one": (edited("drones", dipped), "interlacing", "laid"),
    "pairs roll in the other sense": (edited("drones", rolled_over), "interlacing", "interlacing"),
    "a pair rolls past lying across as others climb": (past("climb", (0, 5), -0.01), "interlacing", "interlacing"),
    "a pair rolls past lying across as the other one rolls": (past("roll", (0, 7), -0.02), "interlacing", "interlacing"),
    "a pair rolls past lying across as weight passes": (past("pass weight", (0, 7), -0.1), "interlacing", "interlacing"),
    "a pair rolls toward its clasp and back as weight passes": (past("pass weight", (0, 5), -0.1), "interlacing", "interlacing"),
    "the wrong leg rolls first": (other_leg_first, "interlacing", "interlacing"),
    # Passing weight.
    "it passes weight as it holds": (called("hold", state=LYING), "interlacing", "interlacing|consistency"),
    "cables pass weight as they are tightened": (named("tension", LYING), "interlacing", "consistency"),
    "a leg stands upright as weight passes": (edited("drones", upended), "equilibrium", "equilibrium"),
    "a leg is longer as weight passes": (moved(("pass weight",), slice(2, 3), 0.03, 0), "cable_length", "cable_length"),
    "a leg is longer as they hold": (moved(("hold",), slice(2, 3), 0.004, 0), "cable_length", "cable_length"),
    "a leg leans as they hold": (moved(("hold",), slice(2, 3), 0.05), "equilibrium", "equilibrium"),
    "it passes weight as it climbs": (called("climb", state=LYING), "interlacing", "consistency"),
    "it passes weight as it rolls": (called("roll", state=LYING), "interlacing", "consistency"),
}  # fmt: skip
"""What is told of the robot that joins, and the check and the rows of ``verify`` that it breaks."""

LEAVING: dict[str, tuple[Change, str, str]] = {
    "the others change places as it leaves": (told(lambda p: replace(p, ring=(1, 0, 2)) if p.ring == AFTER and p.step == 3 else p), "interlacing", "interlacing"),
    "it hangs as it is lifted off": (waits("raise", FREE), "crossing", "crossing"),
    "it is taut as it hangs down again": (waits("slacken", LAYING), "cable_length", "cable_length"),
    "a vertex is elsewhere once it has left": (edited("vertices", drifted_back), "interlacing", "interlacing"),
    "it jumps as it leaves": (moved(("raise",), slice(6, 7), 1e-5), "continuity", "continuity"),
    "it is tied as it leaves": (called("pass weight back", state=ROLLING), "interlacing", "interlacing"),
    "a pair is open as the plan begins": (since("unroll", 3), "interlacing", "interlacing"),
    "it lies on top as the plan begins": (since("raise", 3), "interlacing", "crossing"),
    "it goes down through the hitch": (risen("raise", 0), "interlacing", "interlacing"),
    "it lay 5 cm aside": (moved(("raise",), slice(6, 8), 0.05, 1), "interlacing", "interlacing"),
    "it lay 5 cm above": (moved(("raise",), slice(6, 8), 0.05), "interlacing", "interlacing"),
    "it lay below": (risen("raise", 0, -1.0, 0.025), "interlacing", "interlacing"),
    "a pair rolls as weight passes back": (past("pass weight back", (0, 7), 0.1), "interlacing", "interlacing"),
}  # fmt: skip
"""As JOINING, of the robot that leaves again."""

LAID: dict[str, tuple[Change, str, str]] = {
    "cables are laid in another order": (edited("drones", reordered), "interlacing", "interlacing"),
    "cables slide in too low": (edited("drones", too_low), "interlacing", "interlacing"),
    "cables that slide in are too near": (edited("drones", too_low), "crossing", "crossing|laid"),
    "a cable is laid beyond another one": (edited("drones", too_far), "interlacing", "interlacing"),
    "a cable dips through another one": (within("lay", "drones", np.s_[4:6, 2, 2:-2], -2.0), "interlacing", "laid"),
    "a cable turns as it slides in": (within("slide in", "drones", np.s_[0, 1, 2:-2], 1e-4), "interlacing", "consistency"),
    "one pair rolls in the other sense": (edited("drones", rolled_back), "interlacing", "interlacing"),
    "cables are clasped as they roll": (named("roll", CLASPING), "interlacing", "interlacing"),
    "cables are tightened as they roll": (named("roll", CableState.TIGHTENING), "interlacing", "interlacing"),
    "cables pass weight to nobody": (named("tension", LYING), "interlacing", "consistency"),
    "cables roll as they hold": (named("hold", ROLLING), "interlacing", "consistency"),
    "a cable slides by 3 mm as pairs roll": (slid("roll", 0.003), "interlacing", "consistency"),
    "legs pull more than their cables": (pulled_more, "interlacing", "consistency"),
    "pairs roll with a load": (teamed(load=np.full(3, 0.01)), "interlacing", "consistency"),
    "one cable pulls more": (teamed(tension=np.array([0.7, 0.7, 0.71])), "interlacing", "consistency"),
}  # fmt: skip
"""As JOINING, of a triangle that is laid."""

FORMED_BY_OTHERS = at_first({"ring": (3, 0, 1), "waiting": ((2, GROUND),)})
TRUTHS: dict[str, Callable[[], Motion]] = {
    "phases have other names, and the ring begins at another robot": lambda: turned(
        told(lambda p: replace(p, name="fly"))(joining())
    ),
    "others were to form it": lambda: FORMED_BY_OTHERS(planned("join_a_fourth").motion),
}
"""What is told otherwise, and is no lie."""


def second_opinion(path: Path, limits: list[str]) -> Iterator[second.Row]:
    """Yield the rows of limits alone, which is sooner."""
    return opinion(path, *dict.fromkeys(chain(*(ROWS[limit] for limit in limits))))


def plan_of(name: str) -> Motion:
    """Return the motion of which a lie is told."""
    if name in LAID:
        return planned("lay_triangle").motion
    return joining() if name in JOINING else leaving()


SLOW = {
    # Of LEAVING, lies in JOINING flown backwards
    *("the others change places as it leaves", "it hangs as it is lifted off"),
    *("it is taut as it hangs down again", "it jumps as it leaves", "it is tied as it leaves"),
    *("it lay 5 cm aside", "it lay 5 cm above", "it lay below"),
    # Found by the same lines as others
    *("the ring is told backwards", "it climbs on the ground", "its cable is shorter"),
    *("it passes weight as the plan ends", "it lies 5 cm above", "it comes from close by"),
    *("it hovers, but too steep to be clear", "pairs roll in the other sense"),
    *("a pair rolls past lying across as others climb", "cables pass weight as they are tightened"),
    *("a pair rolls past lying across as the other one rolls", "a leg is longer as they hold"),
    *("a leg stands upright as weight passes", "a leg is longer as weight passes"),
}
"""Lies for ``make test-slow``."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
        for name in (*JOINING, *LEAVING, *LAID)
    ],
)
def test_lies_are_refused_by_both_opinions(name: str, tmp_path: Path) -> None:
    change, first, other = (JOINING | LEAVING | LAID)[name]
    path = tmp_path / "plan.npz"
    write_plan(path, change(plan_of(name)))
    if first == REFUSED:
        with pytest.raises((ho.InputError, FileError)):
            read_plan(path)
    else:
        motion = read_plan(path)
        if first == "interlacing" and motion.has_ring_changes:  # all that its rule counts then
            assert interlacing(chapters(motion)).worst
        else:
            assert not check_of(RULE_OF[first], motion).holds  # type: ignore[union-attr]
    if other == REFUSED:
        with pytest.raises(second.UnreadableError):
            second.read(path)
    else:
        limits = other.split("|")
        assert any(
            row.name in limits and row.verdict == "violated" for row in second_opinion(path, limits)
        )


@pytest.mark.parametrize("name", ["it lies 5 cm above", "it lay 5 cm above"])
def test_a_robot_that_does_not_lie_on_others_is_named_where_it_joins_or_leaves(name: str) -> None:
    motion = plan_of(name)
    found = check_of(RULE_OF["interlacing"], (JOINING | LEAVING)[name][0](motion))
    assert found is not None
    assert not found.holds
    assert found.time == pytest.approx(chapters(motion)[-1].drones.breaks[0])
    assert "cable 3" in found.where


@pytest.mark.parametrize("name", TRUTHS)
def test_the_truth_is_told_by_the_same_rows(name: str, tmp_path: Path) -> None:
    """As it is, and by all rows, it is proven in ``test_verify``."""
    path = tmp_path / "plan.npz"
    write_plan(path, TRUTHS[name]())
    motion = read_plan(path)
    assert not interlacing(chapters(motion)).worst
    limits = ["interlacing", "continuity", "consistency"]
    rows = [row for row in second_opinion(path, limits) if row.samples]
    assert {row.verdict for row in rows} == {"proven"}
    assert {*limits} <= {row.name for row in rows}


def test_nothing_passes_weight_in_a_plan_of_the_same_robots(tmp_path: Path) -> None:
    motion = planned("triangle").motion
    lie = told(lambda p: replace(p, state=LYING))(motion)
    assert not check_of(RULE_OF["interlacing"], lie).holds  # type: ignore[union-attr]
    write_plan(tmp_path / "plan.npz", lie)
    (whole,), _ = second.read(tmp_path / "plan.npz")
    assert {row.verdict for row in second.consistency(whole) if row.name == "consistency"} == {
        "violated"
    }


def test_edges_of_a_ring_that_moves_are_kept_off() -> None:
    ring, alone = (group.motion for group in chapters(joining())[0].groups)
    assert [*vertical_passes(ring, alone)]
    away = ring.vertices.coefficients + np.linspace(0.0, 1e-3, ring.vertices.degree + 1)
    moving = ring.replaced(vertices=ring.vertices.replaced(away))
    assert not [*vertical_passes(moving, alone)]


def test_thrusts_jump_at_seams_by_less_than_a_cable_weighs(monkeypatch: pytest.MonkeyPatch) -> None:
    motion, tension = leaving(), RULE_OF["tension"]
    assert check_of(tension, motion).holds  # type: ignore[union-attr]
    monkeypatch.setattr(ring_change, "GRAVITY", 0.1 * GRAVITY)  # of what cables may leave to others
    found = check_of(tension, motion)
    assert found is not None
    assert 1e-3 < found.bound < np.max(motion.team.cable_weight) * 2.0
    assert found.time in {float(each.drones.breaks[0]) for each in chapters(motion)[1:]}
