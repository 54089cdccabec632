"""Forged plan files: tensions, phases, texts and curves that no planner writes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.cables import SPAN, TENSION
from hitchopt.checks.hanging import split_long_pieces
from hitchopt.checks.linking import INTERLACING
from hitchopt.errors import FileError
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.verify import driver
from hitchopt.verify.arithmetic import Line
from hitchopt.verify.cables import taut_cables
from hitchopt.verify.reading import EFFORT
from hitchopt.verify.spans import PER_FIRST, Spans, prove
from tests.helpers.plans import planned, planned_of

Settings = dict[str, Any]
Arrays = dict[str, Any]

UNTIED = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], "altitude": 1.5}},
    "mission": [{"hold": {"seconds": 0.5}}, {"release": {}}],
}
"""A hitch that is there at the start, and released at rest."""


def forged(
    plan: ho.Plan | ho.Flight, path: Path, change: Callable[[Settings, Arrays], object]
) -> Path:
    """Write a plan with changed settings, or arrays of its first team."""
    write_plan(path, plan.flight if isinstance(plan, ho.Plan) else plan)
    with np.load(path) as file:
        arrays = {name: file[name].copy() for name in file}
    settings = json.loads(str(arrays.pop("settings")))
    change(settings, arrays)
    np.savez(path, settings=np.array(json.dumps(settings)), **arrays)
    return path


def read_by_both(path: Path) -> bool:
    """Return whether both readers read a plan; they agree."""
    readers = [(read_plan, FileError), (second.read, second.UnreadableError)]
    refusals = 0
    for reader, refusal in readers:
        try:
            reader(path)
        except refusal:
            refusals += 1
    assert refusals in (0, len(readers)), path
    return refusals == 0


def names(rows: Iterator[second.Row]) -> set[str]:
    """Return the limits that are not proven."""
    return {row.name for row in rows if row.verdict not in second.PASSING}


def weaker(factor: float, cables: slice = slice(None)) -> Callable[[Settings, Arrays], None]:
    """Multiply tensions of cables."""

    def change(_: Settings, arrays: Arrays) -> None:
        for name in ("tensions", "leg_tensions"):
            arrays[f"groups/0/{name}"][:, cables] *= factor

    return change


def tensions_of(path: Path) -> tuple[second.Row, ho.Check]:
    """Return what both certificates find of the tensions of a plan."""
    (own,), _ = second.read(path)
    return next(row for row in taut_cables(own) if row.name == "tension"), _tension(path)


def _tension(path: Path) -> ho.Check:
    """Return the certificate's check of tensions."""
    check = TENSION.check(read_plan(path).teams[0].motion)
    assert check is not None
    return check


@pytest.mark.parametrize(
    ("is_tied", "factor"),
    [
        (True, 1.0),
        (False, 1.0),
        (False, 0.5),
        *(
            pytest.param(is_tied, factor, marks=pytest.mark.slow)
            for is_tied in (True, False)
            for factor in (1e-12, 1e-4, 0.01, 0.9)
        ),
    ],
)
def test_tensions_rise_to_the_smallest_at_which_a_hitch_is_held(
    *, is_tied: bool, factor: float, tmp_path: Path
) -> None:
    plan = planned("form_square") if is_tied else planned_of(UNTIED)
    row, check = tensions_of(forged(plan, tmp_path / "plan.npz", weaker(factor)))
    assert (row.verdict == "proven") is check.holds is (factor == 1.0)


def test_every_cable_has_its_own_ramp(tmp_path: Path) -> None:
    """One cable that never gets there is found beside others that do."""
    plan = planned("form_square")
    row, check = tensions_of(forged(plan, tmp_path / "plan.npz", weaker(0.5, slice(2, 3))))
    assert (row.verdict, row.where, check.where) == ("violated", "cable 2", ("cable 2",))
    motion = plan.motion
    smallest = motion.team.tension[2]
    start = next(phase.start for phase in motion.phases if phase.state.hitched)
    pull_at_start = 0.5 * motion.tensions.at(start)[2]  # of a cable that hung before
    assert 0.5 * smallest < row.worst <= check.worst
    assert check.worst == pytest.approx(smallest - pull_at_start)


def test_no_tension_falls_between_two_ramps(tmp_path: Path) -> None:
    """It rises, and then falls by half and rises again at the same rest."""
    rested = planned("form_square").flight.prolonged(1.0)

    def dip(_: Settings, arrays: Arrays) -> None:
        for name in ("tensions", "leg_tensions"):
            last = arrays[f"groups/0/{name}"][-1]
            last *= 1.0 - 0.5 * np.sin(np.linspace(0.0, np.pi, last.shape[-1]))

    row, check = tensions_of(forged(rested, tmp_path / "plan.npz", dip))
    assert row.verdict == "violated"
    assert row.worst == pytest.approx(check.worst, rel=0.02)


@pytest.mark.parametrize("is_tied", [True, False])
def test_what_dips_from_the_smallest_tension_and_back_is_no_ramp(
    *, is_tied: bool, tmp_path: Path
) -> None:
    """It is next to cables that are not linked, and both of its ends are at that tension."""
    plan, piece = (planned("form_square"), -1) if is_tied else (planned_of(UNTIED), 1)

    def dip(_: Settings, arrays: Arrays) -> None:
        for name in ("tensions", "leg_tensions"):
            ramp = arrays[f"groups/0/{name}"][piece]
            full = np.max(ramp, axis=-1, keepdims=True)
            ramp[:] = full * (1.0 - 0.5 * np.sin(np.linspace(0.0, np.pi, ramp.shape[-1])))

    row, check = tensions_of(forged(plan, tmp_path / "plan.npz", dip))
    assert row.verdict == "violated"
    assert row.worst == pytest.approx(0.42 * plan.motion.team.tension[0], rel=0.02)
    assert not check.holds


@pytest.mark.parametrize("at", [*(pytest.param(x, marks=pytest.mark.slow) for x in (0, 1)), -1])
def test_phases_shorter_than_files_resolve_alter_nothing(at: int, tmp_path: Path) -> None:
    def shorter(settings: Settings, _: Arrays) -> None:
        phases = settings["groups"][0]["records"]["phases"]
        tiny = {**phases[at], "start": phases[at]["end"] - 1e-7}
        phases[at]["end"] = tiny["start"]
        phases.insert(phases.index(phases[at]) + 1, tiny)

    path = forged(planned("form_square"), tmp_path / "plan.npz", shorter)
    assert read_by_both(path)
    assert names(second.verify(path)) == set()
    assert ho.certify(read_plan(path)).certified


@pytest.mark.parametrize("share", [1e-3, 0.5])
@pytest.mark.parametrize("at", range(5))
def test_phases_may_end_within_pieces(at: int, share: float, tmp_path: Path) -> None:
    """The state is the same on both sides. A half of a swap contradicts its state."""

    def split(settings: Settings, _: Arrays) -> None:
        phases = settings["groups"][0]["records"]["phases"]
        middle = phases[at]["start"] + share * (phases[at]["end"] - phases[at]["start"])
        phases.insert(at + 1, {**phases[at], "start": middle})
        phases[at]["end"] = middle

    path = forged(planned("form_square"), tmp_path / "plan.npz", split)
    assert read_by_both(path)
    flight = read_plan(path)
    checked = [rule.check(flight.teams[0].motion) for rule in (INTERLACING, SPAN, TENSION)]
    assert all(check is not None and (check.holds or share == 0.5) for check in checked)


@pytest.mark.parametrize("end", [0, 1])
def test_edges_of_chains_bend_around_nothing(end: int, tmp_path: Path) -> None:
    def bent(_: Settings, arrays: Arrays) -> None:
        arrays["groups/0/contacts"][:, :, end, 2] += 0.01

    path = forged(planned("open_arc"), tmp_path / "plan.npz", bent)
    assert "bend" in names(second.verify(path))
    violated = ho.certify(read_plan(path), reports=()).violated
    assert any("bends without an object" in check.where[0] for check in violated)


def test_curves_of_kilometres_are_checked_as_others(tmp_path: Path) -> None:
    """No array grows with the distances that drones fly on a piece."""

    def far(_: Settings, arrays: Arrays) -> None:
        arrays["groups/0/drones"][:, :, :, 5] = 1e5

    path = forged(planned("form_square"), tmp_path / "plan.npz", far)
    assert names(second.verify(path))
    motion = read_plan(path).teams[0].motion
    assert split_long_pieces(motion.drones).pieces <= 200 * motion.drones.pieces


def remark(settings: Settings, text: str) -> None:
    settings["groups"][0]["records"]["phases"][0]["remark"] = text


def phase_name(settings: Settings, text: str) -> None:
    settings["groups"][0]["records"]["phases"][0]["name"] = text


def held_object(settings: Settings, text: str) -> None:
    objects = settings["groups"][0]["records"]["requirements"]["objects"]
    objects[text] = {
        "section": {"outline": None, "radius": 0.1},
        **{"lower": 0.0, "upper": 0.1, "mass": 0.1, "friction": 0.5},
        **{"at": [3.0, 3.0, 0.0], "yaw": 0.0, "rim": None, "fixed": True},
    }


def rule_unit(settings: Settings, text: str) -> None:
    settings["rules"] = [
        {"name": "height", "unit": text, "sense": "max", "limit": 2.0, "worst": 1.0}
    ]


def title(settings: Settings, text: str) -> None:
    settings["title"] = text


@pytest.mark.parametrize("text", ["\x1b]0;x\x07", "a\nb", "a\x00", "a\x9b31m"])
@pytest.mark.parametrize("place", [title, remark, phase_name, held_object, rule_unit])
def test_texts_have_no_control_characters(
    place: Callable[[Settings, str], None], text: str, tmp_path: Path
) -> None:
    path = tmp_path / "plan.npz"
    forged(planned("triangle"), path, lambda settings, _: place(settings, text))
    assert not read_by_both(path)


@pytest.mark.parametrize("rule", [rule_unit, remark])
def test_other_texts_are_read(rule: Callable[[Settings, str], None], tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    forged(planned("triangle"), path, lambda settings, _: rule(settings, "größer °"))
    assert read_by_both(path)


def test_a_formula_without_a_bound_ends_within_its_effort(tmp_path: Path) -> None:
    forged(planned("triangle"), tmp_path / "plan.npz", lambda *_: None)
    (plan,), _ = second.read(tmp_path / "plan.npz")
    s = Spans.of(plan, plan.all_pieces, range(plan.N), plan.names)

    def unbounded(s: Spans, i: Any) -> Line:
        x = s.point(i).norm()
        return Line(x.v, x.g, np.full(len(s.x), np.inf), s.t)

    first = len(s.x) * (1 + 16)
    row = prove("speed m/s max", 1e3, s, unbounded)
    assert row.verdict == "not proven"
    assert plan.effort.spent <= 2 * (20_000_000 + 40 * first)


def test_proofs_share_their_effort(tmp_path: Path) -> None:
    """What a proof spends in vain is not there for the next one, but its first passes are."""
    forged(planned("triangle"), tmp_path / "plan.npz", lambda *_: None)
    (plan,), _ = second.read(tmp_path / "plan.npz")
    s = Spans.of(plan, plan.all_pieces, range(plan.N), plan.names)
    plan.effort.allowed = 0
    tight = 1.0 - 1e-12

    def touching(s: Spans, i: Any) -> Line:
        x = s.point(i).norm()
        return Line(0.0 * x.v + tight, x.g, x.q + 1.0, s.t)

    assert prove("speed m/s max", 1.0, s, touching).verdict == "not proven"
    assert plan.effort.spent <= 3 * plan.effort.allowed
    assert prove("speed m/s max", 3.0, s, lambda s, i: s.point(i, 1).norm()).verdict == "proven"


def steps(_: Settings, arrays: Arrays) -> None:
    """Step a drone by 5 mm at every joint."""
    drones = arrays["groups/0/drones"]
    drones[::2, 0, 0] += 0.005


def hinges(_: Settings, arrays: Arrays) -> None:
    """Let both legs of a clasp vanish where they are tied."""
    vertices, drones = arrays["groups/0/vertices"], arrays["groups/0/drones"]
    drones[-1, 0] = vertices[-1, 0, :, -1:]  # of the end, at rest


def flutter(_: Settings, arrays: Arrays) -> None:
    """Let a drone flutter by 4 mm between joints."""
    drones = arrays["groups/0/drones"]
    drones[:, 1, 1, 1:-1:2] += 0.004


@pytest.mark.slow
@pytest.mark.parametrize("forge", [steps, hinges, flutter])
def test_forged_curves_are_refused_within_the_effort_of_all_proofs(
    forge: Callable[[Settings, Arrays], None], tmp_path: Path
) -> None:
    path = forged(planned("form_square"), tmp_path / "plan.npz", forge)
    own, others = second.read(path)
    assert names(driver.proofs(own, others))
    effort = own[0].effort
    assert effort.allowed < EFFORT + PER_FIRST * effort.spent
    assert effort.spent <= 2 * effort.allowed


@pytest.mark.parametrize("tension", [5e-5, 5e-4])
def test_tiny_tensions_hide_no_other_limit(tension: float, tmp_path: Path) -> None:
    """Two drones of a hitch without tension are in one place: more than the tension is judged."""
    start = ho.Hitch.balanced(ho.Team(3, 2.4), [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], 1.5)

    def change(settings: Settings, arrays: Arrays) -> None:
        settings["groups"][0]["records"]["team"]["tension"] = [tension] * 3
        for name in ("tensions", "leg_tensions"):
            arrays[f"groups/0/{name}"] *= 0.0
        drones = arrays["groups/0/drones"]
        drones[:, 0] = drones[:, 1]

    path = forged(ho.solve(start, ho.Hold(0.5)), tmp_path / "plan.npz", change)
    assert names(second.verify(path)) & {"separation", "tension"}
