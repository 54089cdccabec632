"""A law of refusals: every remedy, followed literally, makes the violation smaller.

Each phrase of a remedy is an edit of the problem's file. A phrase without a row in ``PHRASES``
fails, so that a new remedy comes with its edit.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.drones.controllers import stiffest_gains
from hitchopt.errors import Violation
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.solving import AT_START, solve_problem
from hitchopt.storage.yaml_file import read_yaml
from tests.helpers.plans import INFEASIBLE

SIZES = (0.03, 0.3, 1.0, 3.0)
"""Relative sizes of edits, or sizes in metres; larger ones are tried where nothing changes."""

Data = dict[str, Any]


class Advice(NamedTuple):
    """A phrase of a remedy, to be followed in a problem's mapping by an edit of a size."""

    data: Data
    phrase: re.Match[str]
    violation: Violation
    size: float

    def bodies(self) -> Iterator[Data]:
        """Yield the keys of a hitch at the start, and of all steps."""
        if "hitch" in self.data["start"]:
            yield self.data["start"]["hitch"]
        for step in self.data["mission"]:
            yield from step.values()

    def step(self) -> Data:
        """Return the keys of the step that the violation names, or of the hitch at the start."""
        keys: Data
        if self.violation.when == AT_START:
            keys = self.data["start"]["hitch"]
            return keys
        assert self.violation.step is not None, self.violation
        (keys,) = self.data["mission"][self.violation.step].values()
        return keys


Editor = Callable[[Advice], None]


def scale(sign: float, *keys: str) -> Editor:
    """Return the editor that scales values of the file, or their defaults; or the named one."""

    def edit(advice: Advice) -> None:
        problem = problem_from_dict(advice.data)
        for key in keys or [advice.phrase[1]]:
            section, name = key.split(".")
            default = getattr(getattr(problem, section), name.removesuffix("_deg"))
            default = np.degrees(default) if name.endswith("_deg") else default
            values = advice.data.setdefault(section, {})
            values[name] = (factor(advice, sign) * np.asarray(values.get(name, default))).tolist()

    return edit


def factor(advice: Advice, sign: float) -> float:
    """Return the factor of a change up or down, never to zero."""
    return 1.0 + advice.size if sign > 0.0 else 1.0 / (1.0 + advice.size)


def scale_outlines(sign: float) -> Editor:
    def edit(advice: Advice) -> None:
        outlines = [keys for keys in advice.bodies() if "polygon" in keys]
        centre = np.mean(outlines[0]["polygon"], axis=0)
        for keys in outlines:
            arms = np.array(keys["polygon"]) - centre
            keys["polygon"] = (centre + factor(advice, sign) * arms).tolist()

    return edit


def move(advice: Advice, offset: list[float]) -> None:
    """Move the hitch, and the goals of steps, by an offset (3,) [m]."""
    for keys in advice.bodies():
        if "polygon" in keys:
            keys["polygon"] = (np.array(keys["polygon"]) + offset[:2]).tolist()
        if "altitude" in keys:
            keys["altitude"] += offset[2]
        if "to" in keys:
            keys["to"] = (np.array(keys["to"]) + offset[: len(keys["to"])]).tolist()


def fly(sign: float) -> Editor:
    return lambda advice: move(advice, [0.0, 0.0, sign * advice.size])


def lower_floor(advice: Advice) -> None:
    limits = advice.data.setdefault("limits", {})
    limits["floor"] = limits.get("floor", 0.0) - advice.size


def wall_of(advice: Advice) -> tuple[str, int, float]:
    """Return the side and axis of the wall that the remedy names, and the sense away from it."""
    wall = re.search(r"arena\.(\w+)\[(\d)\]", advice.violation.remedy)
    assert wall
    return wall[1], int(wall[2]), 1.0 if wall[1] == "lower" else -1.0


def leave_wall(advice: Advice) -> None:
    _, axis, sense = wall_of(advice)
    move(advice, (sense * advice.size * np.eye(3)[axis]).tolist())


def move_wall(advice: Advice) -> None:
    side, axis, sense = wall_of(advice)
    advice.data["arena"][side][axis] -= sense * advice.size


def place(sign: float, *, robots: bool, drones: bool) -> Editor:
    """Return the editor that moves robots, or the drones of each, together or apart."""

    def edit(advice: Advice) -> None:
        places = advice.data["start"]["drones"]
        both = np.array([places["q"], places["r"]])
        middles = np.mean(both, axis=0)
        offsets = middles - np.mean(middles, axis=0)
        arms = both - middles
        change = (factor(advice, sign) - 1.0) * (robots * offsets + drones * arms)
        places["q"], places["r"] = (both + change * [1.0, 1.0, 0.0]).tolist()

    return edit


def omit_blend(advice: Advice) -> None:
    for keys in advice.bodies():
        keys.pop("blend", None)


def more_time(advice: Advice) -> None:
    for point in advice.step()["path"]:
        point[0] *= 1.0 + advice.size


def begin_there(advice: Advice) -> None:
    advice.step()["path"][0][1:] = advice.data["start"]["hitch"]["polygon"][0]


def shorter_duration(advice: Advice) -> None:
    _, index, key = re.split(r"mission\[(\d+)\]\.\w+\.", advice.phrase[1])
    (keys,) = advice.data["mission"][int(index)].values()
    keys[key] /= 1.0 + advice.size


def shorten_leg(advice: Advice) -> None:
    legs = advice.data["start"]["hitch"]["legs"]
    legs[int(advice.phrase[2])] = 0.5 * float(advice.phrase[1])


def differing_legs(advice: Advice) -> None:
    """Lengthen q-legs, which are the longer ones."""
    keys = advice.step()
    keys["legs"] = (np.array(keys["legs"]) * (1.0 + advice.size)).tolist()


def change_quadrotor(change: Callable[[Advice, ho.Quadrotor], Data]) -> Editor:
    """Return the editor that writes a quadrotor's mass and thrust, and changed keys."""

    def edit(advice: Advice) -> None:
        kind = problem_from_dict(advice.data).team.quadrotor[0]
        keys = {"mass": kind.mass, "max_thrust": kind.max_thrust}
        advice.data["team"]["quadrotor"] = keys | change(advice, kind)

    return edit


def stiffest(_: Advice, kind: ho.Quadrotor) -> Data:
    assert kind.controller
    gains = stiffest_gains(kind.mass, kind.latency, kind.controller)
    return {"controller": kind.controller, "gains": gains}


def scale_objects(sign: float, key: str) -> Editor:
    def edit(advice: Advice) -> None:
        for body in advice.data["objects"].values():
            body[key] *= factor(advice, sign)

    return edit


def smaller_tracking(advice: Advice) -> None:
    tube = problem_from_dict(advice.data).limits.tube
    advice.data.setdefault("limits", {})["tracking"] = factor(advice, -1.0) * tube.level


def either_way(*editors: Editor) -> tuple[Editor, ...]:
    """Return editors of which one has to help, where the remedy names no direction."""
    return editors


LENGTHS_OF_LEGS = either_way(
    scale(1.0, "team.cable_length"),
    scale(-1.0, "team.cable_length"),
    scale_outlines(1.0),
    scale_outlines(-1.0),
)
MOTION = ("limits.speed", "limits.acceleration", "limits.jerk", "limits.vertex_speed")

PHRASES: dict[str, Editor | tuple[Editor, ...]] = {
    "raise the limits of motion": scale(1.0, *MOTION),
    r"raise (limits\.\w+)": scale(1.0),
    r"(?:allow )?a smaller (separation\.\w+|limits\.leg)": scale(-1.0),
    r"lower limits\.floor": lower_floor,
    r"lower ((?:separation|limits|team)\.\w+)": scale(-1.0),
    "change the leg lengths: use cables of another length, or another polygon": LENGTHS_OF_LEGS,
    "(?:use )?(?:a )?longer cables?|lengthen the cable": scale(1.0, "team.cable_length"),
    "(?:use )?(?:a )?shorter cables?": scale(-1.0, "team.cable_length"),
    "(?:use )?a smaller polygon|shorten the edge": scale_outlines(-1.0),
    "(?:use )?a larger polygon": scale_outlines(1.0),
    r"raise the ceiling \(arena\.upper\[2\]\)": move_wall,
    r"move the wall outward \(arena\.\w+\[\d\]\)": move_wall,
    "keep the hitch farther from it": leave_wall,
    "more height": (fly(1.0), move_wall),
    "fly lower": fly(-1.0),
    "(?:start or )?fly higher above the floor": fly(1.0),
    "place the drones farther apart": place(1.0, robots=True, drones=True),
    "place the robots farther apart": place(1.0, robots=True, drones=False),
    r"move q\d+ and r\d+ of start\.drones closer together": place(-1.0, robots=False, drones=True),
    r"allow (\S+) s or more": lambda advice: advice.step().update(duration=float(advice.phrase[1])),
    r"lower (mission\[\d+\]\.\w+\.(?:seconds|duration))": shorter_duration,
    "omit blend": omit_blend,
    "allow more time for the points": more_time,
    "start there, or later": begin_there,
    "choose legs that differ more at the vertex": differing_legs,
    r"cable \d+ leaves (\S+) m for both legs: keep d_(\d+) within it": shorten_leg,
    r"Set team\.quadrotor\.controller to one of (\w+), \w+": change_quadrotor(
        lambda advice, _: {"controller": advice.phrase[1]}
    ),
    "use a drone with more thrust": change_quadrotor(
        lambda advice, kind: {"max_thrust": factor(advice, 1.0) * kind.max_thrust}
    ),
    "use stiffer gains(?: or another controller)?": change_quadrotor(stiffest),
    "lower the object's mass": scale_objects(-1.0, "mass"),
    "use rougher cables": scale_objects(1.0, "friction"),
    "raise the tension": scale(1.0, "team.tension"),
    "set limits.tracking to a smaller measured error": smaller_tracking,
}
"""Phrases of remedies, and the edits that they advise."""

FACTS = (
    "but only to measured errors: .* adds to this distance",
    r", since its tracking errors of .* add to this distance; set limits\.tracking only to "
    "measured errors",
    r"limited by \w+;",
    r"[\d.e-]+ m apart, [\d.e-]+ m too close:",
    r"[\d.e-]+ m apart on a cable of [\d.]+ m:",
    r"edge \d+ is [\d.]+ m long on a cable of [\d.]+ m:",
    r"the path begins at t = 0 at \[.*?\], the vertex is at \[.*?\]:",
    r"pid ignores .* at most [\d.]+ N\.",
    r"are x and y swapped\?",
    "place the drones so that cables need not pass each other",  # of an order, without a measure
    r"move the goal of \w+ or \w+; no delay helps",  # of a swarm
)
"""Parts of remedies that are no edits, or not of a size."""


def refusal(data: Data) -> ho.InfeasibleError | None:
    """Return the refusal of a problem, None for one that is planned."""
    try:
        solve_problem(problem_from_dict(copy.deepcopy(data)))
    except ho.InfeasibleError as error:
        return error
    return None


def worst(error: ho.InfeasibleError | None, name: str) -> Violation | None:
    """Return the violation of a constraint by the largest distance from its limit, if any."""
    named = [] if error is None else [x for x in error.violations if x.constraint == name]
    return max(named, key=shortfall, default=None)


def shortfall(violation: Violation) -> float:
    return abs(violation.value - violation.limit)


def is_smaller(after: Violation | None, before: Violation) -> bool:
    """Return whether a violation is smaller, or its value better, as against a later limit."""
    if after is None or shortfall(after) < shortfall(before):
        return True
    return after.value < before.value if before.sense == "max" else after.value > before.value


def follow(data: Data, phrase: re.Match[str], violation: Violation, edit: Editor) -> bool:
    """Return whether the smallest edit that changes a violation makes it smaller."""
    for size in SIZES:
        edited = copy.deepcopy(data)
        edit(Advice(edited, phrase, violation, size))
        after = worst(refusal(edited), violation.constraint)
        # Legs that share slack evenly are searched: values of like problems differ by 1e-4
        if after is None or not np.isclose(after.value, violation.value, rtol=2e-4, atol=1e-9):
            break
        if after.limit != violation.limit:
            break
    return is_smaller(after, violation)


def useless_remedies(data: Data) -> Iterator[str]:
    """Yield the remedies of a refused problem that do not help, and unknown phrases."""
    error = refusal(data)
    assert error is not None
    crossed = [violation for violation in error.violations if violation.constraint == "crossing"]
    for violation in crossed or error.violations:  # others follow from legs that cross
        rest = violation.remedy
        for fact in FACTS:
            rest = re.sub(fact, " ", rest)
        for pattern, editors in PHRASES.items():
            phrase = re.search(pattern, rest)
            if phrase is None:
                continue
            rest = re.sub(pattern, " ", rest)
            choices = editors if isinstance(editors, tuple) else (editors,)
            if not any(follow(data, phrase, violation, edit) for edit in choices):
                yield f"{phrase[0]!r} does not help: {violation}"
        if unknown := re.sub(r"\bor\b|[\s,;:().]", "", rest):
            yield f"{unknown!r} in no row of PHRASES: {violation}"


def plain(data: Any) -> Any:
    """Return the plain lists, mappings, numbers and words of a file."""
    if isinstance(data, dict):
        return {key: plain(value) for key, value in data.items()}
    return [plain(value) for value in data] if isinstance(data, list) else data


SLOW = {
    "form_cable_too_short",
    "form_ceiling_too_low",
    "same_goal",
    "vertex_moved_too_far",
}


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in INFEASIBLE
    ],
)
def test_every_remedy_makes_its_violation_smaller(path: Any) -> None:
    assert list(useless_remedies(plain(read_yaml(path)))) == []


TRIANGLE = [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]]


def hitch(polygon: list[list[float]], altitude: float, **keys: Any) -> Data:
    """Return the problem of a hitch at rest; keys with two underscores are of sections."""
    data: Data = {
        "team": {"robots": len(polygon), "cable_length": 2.4},
        "start": {"hitch": {"polygon": polygon, "altitude": altitude}},
        "mission": [{"hold": {"seconds": 1.0}}],
    }
    for key, value in keys.items():
        section, _, name = key.partition("__")
        data.setdefault(section, {})[name] = value
    return data


def ring(n: int, radius: float) -> list[list[float]]:
    """Return a regular polygon of n vertices [m], clockwise."""
    angles = -2.0 * np.pi * np.arange(n) / n
    points: list[list[float]] = (
        (radius * np.column_stack([np.cos(angles), np.sin(angles)])).round(4).tolist()
    )
    return points


def arena(height: float, *, half_width: float = 4.0) -> Data:
    return {"lower": [-4, -4, 0], "upper": [half_width, 4, height]}


REFUSED: dict[str, Data] = {
    "ceiling": hitch(TRIANGLE, 1.5) | {"arena": arena(1.49)},
    "ceiling_with_errors": hitch(TRIANGLE, 1.5, limits__tracking=0.05) | {"arena": arena(1.53)},
    "floor": hitch(TRIANGLE, 0.02, limits__tracking=0.05) | {"arena": arena(3.0)},
    "wall": hitch(TRIANGLE, 1.5) | {"arena": arena(3.0, half_width=0.9)},
    "errors_of_soft_gains": hitch(
        TRIANGLE, 1.5, team__quadrotor={"mass": 0.132, "controller": "mellinger"}
    ),
    "errors_beyond_distances": hitch(TRIANGLE, 1.5, limits__tracking=0.3),
    "large_pentagon": hitch(ring(5, 1.9), 1.5),
    "square_beyond_cables": hitch(ring(4, 1.8), 1.5),
}
"""Problems that are refused at rest, by what refuses them."""


@pytest.mark.parametrize("name", REFUSED)
def test_remedies_at_rest_make_violations_smaller(name: str) -> None:
    assert list(useless_remedies(REFUSED[name])) == []


@pytest.mark.parametrize("sharing", ["balanced", pytest.param("spread", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "first_seed", [0, *(pytest.param(first, marks=pytest.mark.slow) for first in (10, 20, 30))]
)
def test_remedies_of_irregular_hitches_make_violations_smaller(
    first_seed: int, sharing: str
) -> None:
    """Of 3 to 8 vertices, on cables that are too short or too long for some of them."""
    refused = 0
    for seed in range(first_seed, first_seed + 10):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(3, 9))
        angles = -np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
        axes = rng.uniform(0.4, 1.5) * np.array([rng.uniform(0.6, 1.4), 1.0])
        polygon = axes * np.column_stack([np.cos(angles), np.sin(angles)])
        data = hitch(polygon.round(4).tolist(), 1.5, team__cable_length=rng.uniform(1.2, 3.0))
        data["start"]["hitch"]["legs"] = sharing
        if refusal(data) is not None:
            refused += 1
            assert list(useless_remedies(data)) == [], f"seed {seed}"
    assert refused > 5
