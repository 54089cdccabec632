"""Plan files without cable states, as earlier versions wrote them, written here array by array."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.motion.motion import CableState
from hitchopt.motion.plan_file import read_plan, read_title

LIMITS = {
    "speed": 1.1,
    "acceleration": 2.2,
    "jerk": 21.0,
    "tilt": 0.7,
    "vertex_speed": 0.4,
    "leg": 0.2,
    "duration": None,
}
SEPARATION = {"radius": 0.11, "height": 0.31, "cable": 0.09, "crossing": 0.04}
BREAKS = [0.0, 1.0, 2.5, 4.0, 5.0, 6.0, 7.5]
PHASES: tuple[tuple[str, bool, str], ...] = (
    ("parked", False, "on the ground"),
    ("take-off", False, "on the ground"),
    ("swap 1", False, "clasping"),
    ("tighten", False, "being tightened"),
    ("hold", True, "hitched"),
    ("apart", False, "hanging free"),
)


def phases(*keys: str) -> list[dict[str, Any]]:
    given = [
        {"name": name, "step": i, "start": a, "end": b, "remark": f"remark {i}", "formed": formed}
        for i, ((name, formed, _), a, b) in enumerate(
            zip(PHASES, BREAKS[:-1], BREAKS[1:], strict=True)
        )
    ]
    return [{key: entry[key] for key in ("name", "step", "start", "end", *keys)} for entry in given]


def saved(path: Path, settings: dict[str, Any], **arrays: Any) -> Path:
    np.savez(
        path,
        allow_pickle=False,
        format=np.array("hitchopt-plan/1"),
        settings=np.array(json.dumps(settings)),
        breaks=np.array(BREAKS),
        **{name: np.array(array, dtype=np.float64) for name, array in arrays.items()},
    )
    return path


def coefficients(*shape: int, seed: int) -> Any:
    return np.random.default_rng(seed).normal(size=(len(BREAKS) - 1, *shape))


def hitch_file(path: Path, team: dict[str, Any] | None = None, **settings: Any) -> Path:
    """A triangle's plan with friction, in an arena, its robots assigned."""
    made = {
        "title": "before",
        "team": {
            "robots": 3,
            "topology": "closed",
            "cable_density": 0.003,
            "cable_friction": 0.1,
            **(team or {}),
        },
        "limits": LIMITS,
        "separation": SEPARATION,
        "arena": {"lower": [-4.0, -3.0, 0.1], "upper": [5.0, 6.0, 3.5]},
        "phases": phases("remark", "formed"),
        "assignment": {"robots": [2, 0, 1], "flipped": [True, False, False]},
        "leg_tensions": True,
        **settings,
    }
    return saved(
        path,
        made,
        mass=[0.13, 0.14, 0.15],
        max_thrust=[2.5, 2.6, 2.7],
        cable_length=[2.4, 2.5, 2.6],
        tension=[0.4, 0.45, 0.5],
        drones=coefficients(6, 3, 4, seed=1),
        vertices=coefficients(3, 3, 3, seed=2),
        legs=coefficients(3, 2, 3, seed=3),
        tensions=coefficients(3, 2, seed=4),
        leg_tensions=coefficients(3, 2, 2, seed=5),
    )


def test_every_number_and_word_of_a_hitch_comes_back(tmp_path: Path) -> None:
    path = hitch_file(tmp_path / "plan.npz")
    motion, team = read_plan(path), read_plan(path).team
    assert read_title(path) == "before"
    found = (team.robots, team.topology, team.cable_density, team.cable_friction)
    assert found == (3, "closed", 0.003, 0.1)
    np.testing.assert_array_equal(team.cable_length, [2.4, 2.5, 2.6])
    np.testing.assert_array_equal(team.tension, [0.4, 0.45, 0.5])
    assert [(kind.mass, kind.max_thrust) for kind in team.quadrotor] == [
        (0.13, 2.5),
        (0.14, 2.6),
        (0.15, 2.7),
    ]
    controllers = {(kind.stiffness, kind.integral, kind.feed_forward) for kind in team.quadrotor}
    assert controllers == {(None, False, True)}
    requirements, assignment = motion.requirements, motion.assignment
    assert vars(requirements.limits) == LIMITS | {"body_rate": None, "reserve": 1.0}
    assert vars(requirements.separation) == SEPARATION | {"object": 0.035}
    assert requirements.arena is not None
    assert requirements.arena.lower.tolist() == [-4.0, -3.0, 0.1]
    assert requirements.arena.upper.tolist() == [5.0, 6.0, 3.5]
    assert requirements.keep_out == ()
    assert assignment is not None
    assert (assignment.robots, assignment.flipped) == ((2, 0, 1), (True, False, False))
    shapes = {"drones": (6, 3, 4), "vertices": (3, 3, 3), "legs": (3, 2, 3), "tensions": (3, 2)}
    for seed, (name, shape) in enumerate({**shapes, "leg_tensions": (3, 2, 2)}.items(), 1):
        part = getattr(motion, name)
        np.testing.assert_array_equal(part.coefficients, coefficients(*shape, seed=seed))
        assert part.breaks.tolist() == BREAKS


def test_states_follow_from_names_and_flags(tmp_path: Path) -> None:
    motion = read_plan(hitch_file(tmp_path / "plan.npz"))
    assert [str(phase.state) for phase in motion.phases] == [state for _, _, state in PHASES]
    for i, (phase, (name, formed, _)) in enumerate(zip(motion.phases, PHASES, strict=True)):
        assert (phase.name, phase.step, phase.remark) == (name, i, f"remark {i}")
        assert (phase.start, phase.end, phase.formed) == (BREAKS[i], BREAKS[i + 1], formed)
        assert phase.tension is None
    older = read_plan(hitch_file(tmp_path / "older.npz", phases=phases()))  # than the flag
    assert {phase.state for phase in older.phases} == {CableState.HITCHED}
    assert {phase.remark for phase in older.phases} == {""}
