"""fly.py of every part, flown by a stand-in for the fleet that evaluates uploaded memory."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from exported_plans import exported, hitch_plan
from flying_stand_in import Array, Craft, Fleet, OldCraft, Rows
from ruamel.yaml import YAML

from hitchopt.exports.exporting import Export
from hitchopt.mission.loading import load_problem
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.motion import Motion

PROBLEM = Path(__file__).parents[2] / "problems" / "tie_carry_untie.yaml"

CONTINUOUS = 2e-3
"""[m] Setpoints that jump by less are those of polynomials looked at now and then."""


@lru_cache
def whole_mission() -> Motion:
    return solve_problem(load_problem(PROBLEM)).motion


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Export, ...]:
    return exported(whole_mission(), "crazyswarm2", tmp_path_factory.mktemp("mission"))


def standing(folder: Path) -> dict[str, Array]:
    """Where the settings say that drones stand."""
    robots = YAML(typ="safe").load(folder / "crazyflies.yaml")["robots"]
    return {name: np.array(robot["initial_position"]) for name, robot in robots.items()}


def rows(folder: Path, name: str) -> Array:
    trajectory = Rows()
    trajectory.loadcsv(folder / f"{name}.csv")
    return trajectory.rows


def end_of(folder: Path, name: str) -> Array:
    last = rows(folder, name)[-1]
    place: Array = last[1:25].reshape(3, 8) @ last[0] ** np.arange(8)
    return place


@pytest.mark.slow
def test_no_setpoint_jumps_through_all_parts(
    parts: tuple[Export, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(parts) == 3
    fleet = Fleet(standing(parts[0].folder))
    for number, part in enumerate(parts, 1):
        more = number < len(parts)
        options = ["--from-here"] if number > 1 else []
        fleet.run(monkeypatch, part.folder / "fly.py", options, "stay\n" if more else "")
        assert fleet.worst_jump < CONTINUOUS
        for name, craft in fleet.crazyfliesByName.items():
            assert craft.state == ("flying" if more else "idle")
            apart = np.linalg.norm(craft.setpoint[0] - end_of(part.folder, name))
            assert apart < 1e-5  # the plan ends on the floor: landing moves nobody


@pytest.mark.slow
def test_started_in_the_air_without_its_option_nothing_jumps_either(
    parts: tuple[Export, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = Fleet(standing(parts[0].folder))
    fleet.run(monkeypatch, parts[0].folder / "fly.py", answer="stay")
    fleet.run(monkeypatch, parts[1].folder / "fly.py")
    assert fleet.worst_jump < CONTINUOUS
    assert {craft.state for craft in fleet.crazyfliesByName.values()} == {"idle"}
    assert all(c.setpoint[0, 2] == pytest.approx(0.04) for c in fleet.crazyfliesByName.values())


@pytest.mark.parametrize(
    ("kind", "needs_arming"), [(Craft, True), (OldCraft, False)], ids=["brushless", "brushed"]
)
def test_a_whole_plan_from_take_off_to_landing(
    kind: type[Craft], needs_arming: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    beside = {name: place + [0.05, -0.03, 0.01] for name, place in standing(tmp_path).items()}
    fleet = Fleet(beside, kind, needs_arming)
    fleet.run(monkeypatch, tmp_path / "fly.py")
    assert fleet.worst_jump < CONTINUOUS
    for name, craft in fleet.crazyfliesByName.items():
        landed = [*end_of(tmp_path, name)[:2], 0.04]
        np.testing.assert_allclose(craft.setpoint[0], landed, atol=1e-5)
    names = hitch_plan().team.drone_names
    alone = [
        (name, call)
        for call in (["arm"] if needs_arming else []) + ["goTo", "uploadTrajectory"]
        for name in names
    ]
    together = [call for who, call in fleet.calls if who == "all"]
    assert [call for call in fleet.calls if call[0] != "all"] == alone
    assert together == ["takeoff", "startTrajectory", "land"]
    note = (tmp_path / "README.txt").read_text(encoding="utf-8")
    assert note.index("goTo (absolute)") < note.index("only then upload")
    assert "Brushless" in note
    assert "relative=False" in note
    assert "placeholders" in note


def test_parts_tell_their_place_in_the_plan(parts: tuple[Export, ...]) -> None:
    text = [(part.folder / "README.txt").read_text(encoding="utf-8") for part in parts]
    for number, part in enumerate(parts, 1):
        reported = f"part {number} of 3, t = {part.begins:.3f} s to "
        assert any(note.startswith(reported) for note in part.notes)
        assert reported in text[number - 1]
        assert reported in (part.folder / "fly.py").read_text(encoding="utf-8")
