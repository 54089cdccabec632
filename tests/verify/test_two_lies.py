"""Two cables tied around an object: lies about ends, sides, balance and states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hitchopt import verify as second
from hitchopt.checks import certify
from hitchopt.checks.certifying import check_of
from hitchopt.checks.registry import RULE_OF
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import CableState, HoldBy, Motion, Phase, PhaseHold
from hitchopt.values import Array, Indices
from hitchopt.verify.tying import bent_cables
from tests.helpers.groups import part
from tests.helpers.plans import planned
from tests.helpers.second_opinions import ROWS, opinion_of

Change = Callable[[Motion], Motion]
REFUSED = "refused"
"""The motion cannot be made, or the file cannot be read as a plan."""

BENT, DRAWN, FREE = CableState.BENT, CableState.DRAWN, CableState.FREE
HITCHED, ROLLING, LAYING = CableState.HITCHED, CableState.ROLLING, CableState.LAYING
AT = 0.3
"""Height of the clasps [m]."""

ENDS = ([0, 3], [2, 1])
"""Drones of both clasps."""


class Lie(NamedTuple):
    """What is told of a part of the plan, and the check and the row of ``verify`` that it breaks."""

    part: str
    words: str
    change: Change
    check: str
    row: str


PARTS = {
    "tie": ("drum", "draw taut", "tighten"),
    "carry": ("drum", "tighten", "lift"),
    "untie": ("drum", "loosen", "slacken"),
    "lip": ("lip", "tighten", "lift"),
}


@cache
def parts(name: str) -> Motion:
    """Return the part of a plan with a drum, or a lip, that ties, carries or unties it."""
    problem, first, last = PARTS[name]
    return part(planned(f"two_robots_{problem}").motion, first, last)


def pieces(motion: Motion, *names: str) -> Indices:
    """Return the pieces of phases with a name."""
    on = [phase.name in names for phase in motion.phases]
    return np.flatnonzero(np.array(on)[motion.phase_of_piece])


def edited(curve: str, names: str, edit: Callable[[Array], Any], where: Any = ...) -> Change:
    """Edit a curve (pieces, …, degree + 1) in phases."""

    def change(motion: Motion) -> Motion:
        own = getattr(motion, curve)
        c, on = own.coefficients.copy(), pieces(motion, *names.split(", "))
        part = c[on]
        part[where] = edit(part[where])
        c[on] = part
        return motion.replaced(**{curve: own.replaced(c)})

    return change


def all_of(*changes: Change) -> Change:
    """Make several changes."""

    def change(motion: Motion) -> Motion:
        for each in changes:
            motion = each(motion)
        return motion

    return change


def told(names: str, **values: Any) -> Change:
    """Say something else of phases."""

    def change(phase: Phase) -> Phase:
        return replace(phase, **values) if phase.name in names.split(", ") else phase

    return lambda motion: motion.replaced(phases=tuple(map(change, motion.phases)))


def of_object(**values: Any) -> Change:
    """Say something else of the only object."""

    def change(motion: Motion) -> Motion:
        (name, body), *_ = motion.requirements.objects.items()
        objects = {name: replace(body, **values)}
        return motion.replaced(requirements=replace(motion.requirements, objects=objects))

    return change


def teamed(**values: Any) -> Change:
    """Say something else of the team."""
    return lambda motion: motion.replaced(team=replace(motion.team, **values))


def bump(axis: int, by: float = 0.1) -> Callable[[Array], Array]:
    """Move points by up to 2 cm within the piece in the middle, and back [m]."""

    def change(c: Array) -> Array:
        c[len(c) // 2, :, axis, 2:-2] += by
        return c

    return change


def mirrored(z: Array) -> Array:
    """Return heights below the clasps for those above them, and the other way round."""
    return 2.0 * AT - z


def turned_over(names: str, *ends: int, on: slice = slice(None)) -> Change:
    """Exchange the heights of the drones of clasps, and of the inner ends of their legs."""
    drones = [drone for end in ends for drone in ENDS[end]]
    anchors = np.s_[on, [d // 2 for d in drones], [d % 2 for d in drones], 2]
    return all_of(
        edited("drones", names, mirrored, np.s_[on, drones, 2]),
        edited("anchors", names, mirrored, anchors),
    )


def plus(*offset: float) -> Callable[[Array], Array]:
    """Add an offset to points (…, 3, degree + 1) [m]."""
    return lambda c: c + np.array(offset)[:, None]


def back(c: Array) -> Array:
    """Return pieces that go half of their path, and return."""
    half = len(c) // 2
    return np.concatenate([c[:half], c[: len(c) - half][::-1, ..., ::-1]])


def on_one_side(motion: Motion) -> Motion:
    """Let cable 1 bend around the same side as cable 0."""
    ends = edited("drones", "straddle, lay", lambda c: c[:, [0, 1, 1, 0]])
    reverse = [
        edited(x, "straddle, lay", lambda c: np.stack([c[:, 0], c[:, 0, ::-1]], 1))
        for x in ("contacts", "anchors")
    ]
    return all_of(ends, *reverse)(motion)


def lowered(motion: Motion) -> Motion:
    """Let cable 0 be 5 cm lower as cables come to lie on each other."""
    down = plus(0.0, 0.0, -0.05)
    cables = (edited(x, "lay", down, np.s_[:, 0]) for x in ("contacts", "anchors"))
    return all_of(edited("drones", "lay", down, np.s_[:, :2]), *cables)(motion)


def at_rest(
    phase: str, shares: tuple[float, float], angle: float, offset: tuple[float, ...] = (0, 0, 0)
) -> Change:
    """Let cables rest as they are at shares of a phase, with the second one turned and moved."""

    def change(motion: Motion) -> Motion:
        own = part(motion, phase, phase)
        one, (c, s) = (
            own.slice_pieces(slice(0, 1), own.phases),
            np.array([np.cos(angle), np.sin(angle)]),
        )
        curves = {}
        for name in ("drones", "anchors", "contacts"):
            curve, resting = getattr(own, name), getattr(one, name)
            first, second = (curve.at(share * own.duration).reshape(2, 2, 3) for share in shares)
            second = second @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + offset
            places = np.stack([first[0], second[1]]).reshape(1, *resting.shape, 1)
            curves[name] = resting.replaced(places + 0.0 * resting.coefficients)
        phases = (own.phases[0].retimed(*one.drones.breaks.tolist()),)
        return one.replaced(phases=phases, **curves)

    return change


def jump(c: Array) -> Array:
    """Shift the piece in the middle by 0.1 mm."""
    c[len(c) // 2] += 1e-4
    return c


HEAVY = of_object(mass=5.0)
REST = PhaseHold("drum", HoldBy.REST, (0, 1))
ALONE = PhaseHold("drum", HoldBy.GRIP, (0,))

LIES = [
    # Senses and turns.
    Lie("tie", "one clasp has the other sense", turned_over("straddle, lay, roll", 1), "interlacing", "interlacing"),
    Lie("tie", "one pair rolls in the other sense", turned_over("roll", 1), "interlacing", "interlacing"),
    Lie("tie", "both pairs roll in the other sense", turned_over("roll", 0, 1), "interlacing", "interlacing"),
    Lie("tie", "r-ends cross over q-ends", turned_over("straddle, lay", 0, 1), "interlacing", "interlacing"),
    Lie("tie", "r-ends cross over q-ends at one clasp", turned_over("straddle, lay", 0), "interlacing", "interlacing"),
    Lie("tie", "pairs roll by a quarter, and back", edited("drones", "roll", back), "interlacing", "interlacing"),
    Lie("tie", "a pair rolls by a quarter, and back", edited("drones", "roll", back, np.s_[:, [0, 3]]), "interlacing", "interlacing"),
    Lie("tie", "cables that lie on each other are hitched", told("roll", state=HITCHED), "equilibrium", "contact"),
    Lie("tie", "pairs that roll are bent", told("roll", state=BENT), "equilibrium", "equilibrium"),
    Lie("tie", "all is bent, and never hitched", told("roll, draw, tighten", state=BENT), "equilibrium", "equilibrium"),
    Lie("tie", "a cable dips through the other, and back", turned_over("lay", 0, on=slice(10, 14)), "interlacing", "laid"),
    Lie("tie", "cables pass through each other as they are laid", turned_over("lay", 1, on=slice(4, None)), "interlacing", "laid"),
    Lie("tie", "cables are exchanged", edited("drones", "straddle, lay", lambda c: c[:, [2, 3, 0, 1]]), "interlacing", "laid"),
    Lie("untie", "pairs do not unroll", told("unroll", state=HITCHED), "equilibrium", "contact"),
    Lie("untie", "pairs unroll in the other sense", turned_over("unroll", 0, 1), "interlacing", "interlacing"),
    Lie("untie", "one pair unrolls in the other sense", turned_over("unroll", 1), "interlacing", "interlacing"),
    Lie("untie", "q-ends are lifted through r-ends", turned_over("lift, unstraddle", 0, 1), "interlacing", "interlacing"),
    Lie("untie", "a hitch comes apart as it is", told("unroll, lift", state=BENT), "interlacing", "interlacing"),
    # Places of cables.
    Lie("tie", "both cables are on one side", on_one_side, "grip", "passing"),
    Lie("tie", "the drum is beside the cables", edited("poses", "straddle, lay", lambda c: c + np.eye(5)[0][:, None] * 0.05), "grip", "wrap"),
    Lie("tie", "nothing is around the cables as they bend", told("straddle", hold=None), "grip", "bend"),
    Lie("tie", "nothing is around the cables as they roll", told("roll", hold=None), "grip", "consistency"),
    Lie("tie", "nothing is around the cables as they are drawn", told("draw", hold=None), "grip", "consistency"),
    Lie("tie", "the drum rests on two clasps", told("draw, tighten", hold=REST), "support", REFUSED),
    Lie("tie", "one cable holds the drum", told("draw, tighten", hold=ALONE), "object_clearance", REFUSED),
    Lie("tie", "anchors are 3 cm aside", edited("anchors", "straddle", plus(0.0, 0.03, 0.0)), "equilibrium", "equilibrium"),
    Lie("tie", "anchors are 3 cm higher", edited("anchors", "lower", plus(0.0, 0.0, 0.03)), "equilibrium", "equilibrium"),
    Lie("tie", "an anchor is 1 mm outward", edited("anchors", "lay", plus(0.001, 0.0, 0.0), np.s_[:, 0, 0]), "cable_length", "cable_length"),
    Lie("tie", "contacts are 1 cm aside", edited("contacts", "lay", plus(0.01, 0.0, 0.0)), "grip", "wrap"),
    Lie("tie", "contacts are 20 cm higher", edited("contacts", "lay", plus(0.0, 0.0, 0.2)), "grip", "wrap"),
    Lie("tie", "edges are straight", edited("contacts", "lay", lambda c: np.repeat(np.mean(c, axis=2, keepdims=True), 2, axis=2)), "grip", "wrap"),
    Lie("tie", "cables touch each other at their q-ends", at_rest("lower", (0.0, 0.0), np.pi / 2, (-0.574, 0.274, 0.0)), "interlacing", "crossing"),
    Lie("tie", "cables touch each other at their r-ends", at_rest("lower", (0.0, 0.0), np.pi / 2, (-0.274, 0.574, 0.0)), "crossing", "crossing"),
    Lie("tie", "cables pass 3 cm above each other", at_rest("lower", (0.0, 0.0), np.pi / 2, (-0.574, 0.274, 0.03)), "crossing", "crossing"),
    Lie("tie", "cables overlap on one side", all_of(HEAVY, at_rest("straddle", (1.0, 1.0), np.radians(165.0))), "interlacing", "crossing"),
    Lie("tie", "a cable is below the other on one side", all_of(HEAVY, at_rest("straddle", (1.0, 0.5), np.pi)), "interlacing", "crossing"),
    Lie("tie", "anchors jump", edited("anchors", "lower", jump, np.s_[:, 0, 0, 0]), "continuity", "continuity"),
    Lie("tie", "legs jump", edited("legs", "lower", jump, np.s_[:, 1, 1]), "continuity", "continuity"),
    # Forces.
    Lie("carry", "the drum is as heavy as three", of_object(mass=0.24), "grip", "grip"),
    Lie("carry", "the drum is smooth", of_object(friction=0.1), "grip", "grip"),
    Lie("carry", "the drum is taller, and falls over", of_object(upper=0.6), "hinge", "hinge"),
    Lie("carry", "the drum is a little taller than errors permit", of_object(upper=0.55), "hinge", "hinge"),
    Lie("carry", "another tension was asked", teamed(tension=1.2), "tension", "tension"),
    Lie("tie", "the drum is light, and pushed over", all_of(of_object(mass=0.005), lowered), "support", "support"),
    Lie("tie", "one cable pulls harder as they bend", edited("tensions", "straddle", lambda T: 1.2 * T, np.s_[:, 0]), "tension", "tension"),
    Lie("tie", "another tension is stated", told("straddle", tension=(0.5, 0.6)), "tension", "tension"),
    Lie("tie", "cables bend without tension", edited("tensions", "straddle", lambda T: 0.0 * T), "tension", "tension"),
    Lie("tie", "legs are 1 mm longer", edited("legs", "straddle", lambda d: d + 1e-3), "cable_length", "cable_length"),
    Lie("tie", "the drum is carried as pairs roll", edited("load_share", "roll", lambda c: 0.0 * c + 1.0), "interlacing", "consistency"),
    # States.
    Lie("tie", "cables that lie on each other roll", told("lay", state=ROLLING), "interlacing", "interlacing"),
    Lie("tie", "pairs that roll are laid", told("roll", state=LAYING), "interlacing", REFUSED),
    Lie("tie", "pairs roll, and are back at once", edited("drones", "roll", lambda c: c[..., :1] + 0.0 * c), "continuity", "continuity"),
    Lie("tie", "cables that bend are drawn taut", told("straddle", state=DRAWN), "interlacing", "consistency"),
    Lie("tie", "cables that bend hang free", told("straddle, lay", state=FREE), "interlacing", "consistency"),
    Lie("tie", "cables that bend are laid", told("straddle, lay", state=LAYING), "interlacing", REFUSED),
    Lie("tie", "clasps that are drawn bend", told("draw", state=BENT), "equilibrium", "equilibrium"),
    Lie("tie", "hanging cables bend", told("draw taut", state=BENT), "tension", "cable_length"),
    Lie("tie", "cables that are drawn taut hang free", told("draw taut", state=FREE), "tracking_radius", "span"),
    Lie("tie", "drones snap cables taut", lambda x: part(x, "draw taut", "draw taut").slowed(0.5), "tracking_radius", "span"),
    Lie("tie", "drones rise as they draw cables taut", edited("drones", "draw taut", bump(2)), "interlacing", "consistency"),
    Lie("tie", "drones turn back as they draw cables taut", edited("drones", "draw taut", bump(0), np.s_[:, :1]), "interlacing", "drawn"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTS)
def test_parts_as_they_are_are_proven(name: str, tmp_path: Path) -> None:
    assert certify(parts(name), reports=()).certified
    assert {row.verdict for row in opinion_of(parts(name), tmp_path)} == {"proven"}


@pytest.mark.parametrize("name", ["tie", "untie"])
def test_bent_cables_as_they_are_are_proven(name: str, tmp_path: Path) -> None:
    rows = opinion_of(parts(name), tmp_path, bent_cables)
    assert {row.verdict for row in rows} == {"proven"}


@pytest.mark.parametrize(
    "lie",
    [pytest.param(lie, id=f"{lie.part}: {lie.words}") for lie in LIES],
)
def test_lies_are_refused(lie: Lie, tmp_path: Path) -> None:
    motion = lie.change(parts(lie.part))
    if lie.check in RULE_OF:
        check = check_of(RULE_OF[lie.check], Flight.of(motion))
    else:
        check = certify(motion, reports=())[lie.check]
    assert check is not None
    assert not check.holds
    if lie.row == REFUSED:
        with pytest.raises(second.UnreadableError):
            [*opinion_of(motion, tmp_path)]
    else:
        rows = opinion_of(motion, tmp_path, *ROWS[lie.row])
        assert any(row.name == lie.row and row.verdict != "proven" for row in rows)
