"""A hundred kinds of lies that a plan file can tell are refused, reported, or none."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.errors import FileError
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.plan_file import write_plan
from hitchopt.plan import read_requested_plan
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.trajectory import bernstein
from hitchopt.values import Array
from hitchopt.verify import driver
from tests.helpers.plans import PROBLEMS, planned

Settings = dict[str, Any]
Arrays = dict[str, Any]
Change = Callable[[Settings, Arrays], object]
REFUSED = "refused"
"""The file cannot be read as a plan."""


class Lie(NamedTuple):
    """What is told of a plan, and the limits one of which it breaks; or why it is no lie."""

    plan: str
    words: str
    change: Change
    found: str
    reason: str = ""


def edited(name: str, edit: Callable[[Array], Any], where: Any = ...) -> Change:
    """Edit an array, or a part of it."""

    def change(_: Settings, arrays: Arrays) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name][where] = edit(arrays[name][where])

    return change


def times(name: str, factor: float, where: Any = ...) -> Change:
    """Multiply an array, or a part of it."""
    return edited(name, lambda x: x * factor, where)


def plus(name: str, value: Any, where: Any = ...) -> Change:
    """Add to an array, or to a part of it."""
    return edited(name, lambda x: x + value, where)


def swapped(name: str, i: int, j: int, axis: int = 1) -> Change:
    """Exchange two items of an array."""
    exchanged = {i: j, j: i}

    def change(_: Settings, arrays: Arrays) -> None:
        order = [exchanged.get(k, k) for k in range(arrays[name].shape[axis])]
        arrays[name] = np.take(arrays[name], order, axis)

    return change


def put(*keys: Any) -> Change:
    """Set an entry of the settings: keys, then the value; called on the old value if that is one."""

    def change(settings: Settings, _: Arrays) -> None:
        entry: Any = settings
        for key in keys[:-2]:
            entry = entry[key]
        value = keys[-1]
        entry[keys[-2]] = value(entry[keys[-2]]) if callable(value) else value

    return change


def both(*changes: Change) -> Change:
    """Make several changes."""
    return lambda settings, arrays: [change(settings, arrays) for change in changes]


def everywhere(key: str, value: Any, name: str = "") -> Change:
    """Set an entry of all phases, or of those with a name."""

    def change(settings: Settings, _: Arrays) -> None:
        for phase in settings["phases"]:
            if name in ("", phase["name"]):
                phase[key] = value(phase[key]) if callable(value) else value

    return change


def stated(old: str, new: str) -> Change:
    """Say that phases in one state are in another one."""
    return everywhere("state", lambda state: new if state == old else state)


def removed(key: str) -> Change:
    """Take a key out of the settings, or an array."""
    return lambda settings, arrays: (arrays if key in arrays else settings).pop(key)


CURVES = (
    *("drones", "vertices", "legs", "tensions"),
    *("leg_tensions", "poses", "load_share", "contacts"),
)


def backwards(_: Settings, arrays: Arrays) -> None:
    """Fly the plan from its end."""
    arrays.update({name: arrays[name][::-1, ..., ::-1] for name in CURVES})
    arrays["breaks"] = (arrays["breaks"][-1] - arrays["breaks"])[::-1]


def split(_: Settings, arrays: Arrays) -> None:
    """Cut the first piece in two."""
    arrays["breaks"] = np.insert(arrays["breaks"], 1, np.mean(arrays["breaks"][:2]))
    for name in CURVES:
        halves = np.stack(bernstein.halve(arrays[name][0]))
        arrays[name] = np.concatenate([halves, arrays[name][1:]])


def hover(_: Settings, arrays: Arrays) -> None:
    """Say that nothing moves from the first piece on."""
    for name in CURVES:
        edited(name, lambda c: c[:1, ..., :1])({}, arrays)


def assigned(change: Callable[[list[int], list[bool]], object]) -> Change:
    """Change which of three robots fly which roles, and which ends."""

    def told(settings: Settings, _: Arrays) -> None:
        given = settings.setdefault("assignment", {"robots": [0, 1, 2], "flipped": [False] * 3})
        change(given["robots"], given["flipped"])

    return told


exchanged = assigned(lambda robots, _: robots.insert(0, robots.pop(1)))
flipped = assigned(lambda _, ends: ends.__setitem__(0, not ends[0]))


def pieces_in(settings: Settings, arrays: Arrays, word: str) -> list[Any]:
    """Return the pieces of every phase in a state, or with a name."""
    middles = 0.5 * (arrays["breaks"][1:] + arrays["breaks"][:-1])
    phases = [p for p in settings["phases"] if word in (p["state"], p["name"])]
    spans = [(p["start"], p["end"]) for p in phases]
    return [np.flatnonzero((middles > start) & (middles < end)) for start, end in spans]


def turned_back(settings: Settings, arrays: Arrays) -> None:
    """Let drones turn back where they should turn on: the first swap, backwards, for the second."""
    first, second = pieces_in(settings, arrays, "clasping")
    again = arrays["drones"][first[::-1], ..., ::-1]
    edited("drones", lambda _: again, second)(settings, arrays)


def at_once(settings: Settings, arrays: Arrays) -> None:
    """Let cables pull as soon as there is a hitch."""
    for pieces in pieces_in(settings, arrays, "hitched"):
        edited("tensions", lambda _: arrays["tension"][:, None], pieces)(settings, arrays)


def tight(settings: Settings, arrays: Arrays) -> None:
    """Let cables pull three times as hard while they are tightened."""
    for pieces in pieces_in(settings, arrays, "being tightened"):
        times("tensions", 3.0, pieces)(settings, arrays)


def turning(settings: Settings, arrays: Arrays) -> None:
    """Turn what is carried by 0.3 rad against its clasps."""
    c, s = np.cos(0.3), np.sin(0.3)
    where = (slice(None), 2, slice(3, 5))
    edited("poses", lambda heading: [[c, -s], [s, c]] @ heading, where)(settings, arrays)


def slipped(item: int, angle: float, sunk: float = 0.0) -> Change:
    """Turn what is carried against what holds it, and let it sink, bit by bit at joints."""

    def change(settings: Settings, arrays: Arrays) -> None:
        c, (carry,) = arrays["poses"], pieces_in(settings, arrays, "carry")
        share = np.clip((np.arange(len(c)) - carry[0]) / len(carry), 0.0, 1.0)
        x = (c[:, item, 3] + 1j * c[:, item, 4]) * np.exp(1j * angle * share)[:, None]
        new = np.stack([x.real, x.imag], axis=1)
        edited("poses", lambda _: new, np.s_[:, item, 3:])(settings, arrays)
        plus("poses", -sunk * share[:, None], np.s_[:, item, 2])(settings, arrays)

    return change


def left_there(settings: Settings, arrays: Arrays) -> None:
    """Leave the box where it is about to be set down: in the air."""
    (down,) = pieces_in(settings, arrays, "set_down")
    edited("poses", lambda x: x[:1, :, :1], np.s_[down[0] :, 2])(settings, arrays)


def small_rim(settings: Settings, _: Arrays) -> None:
    """Make the rim half as wide."""
    rim = settings["objects"]["box"]["rim"]["section"]
    rim.update({key: (0.5 * np.array(x)).tolist() for key, x in rim.items() if x is not None})


def lifted(settings: Settings, arrays: Arrays) -> None:
    """Let the box be 5 cm higher all the time."""
    put("objects", "box", "at", lambda at: [*at[:2], at[2] + 0.05])(settings, arrays)
    index = list(settings["objects"]).index("box")
    plus("poses", 0.05, (slice(None), index, 2))(settings, arrays)


def pierced(settings: Settings, arrays: Arrays) -> None:
    """Make a slim pillar of the shelf, through the rim of the box."""
    outline = [[0.01, 0.01], [0.01, -0.01], [-0.01, -0.01], [-0.01, 0.01]]
    section = {"outline": outline, "radius": None}
    settings["objects"]["shelf"] |= {"section": section, "upper": 1.0, "at": [2.42, 0.0, 0.0]}
    arrays["poses"] = arrays["poses"].copy()
    arrays["poses"][:, list(settings["objects"]).index("shelf"), :3] = [[2.42], [0.0], [0.0]]


def in_phases(word: str, name: str, edit: Callable[[Array], Any], where: Any = ...) -> Change:
    """Edit a part of an array on the pieces of phases in a state, or with a name."""

    def change(settings: Settings, arrays: Arrays) -> None:
        pieces = np.concatenate(pieces_in(settings, arrays, word))
        part = arrays[name][pieces].copy()
        part[where] = edit(part[where])
        edited(name, lambda _: part, pieces)(settings, arrays)

    return change


LAYERS = 0.05 * np.array([[0.0], [0.0], [1.0], [1.0], [2.0], [2.0]])  # [m]


def turned_over(z: Array) -> Array:
    """Return heights of drones that roll in the other sense, about that of the clasps."""
    return 2.0 * np.mean(z[-1, :, -1]) - z


def nearer(x: Array) -> Array:
    """Return cables whose first drone is 4 mm nearer to its partner, twice what sags allow."""
    along = x[:, 1] - x[:, 0]
    x[:, 0] += 0.004 * along / np.linalg.norm(along, axis=1, keepdims=True)
    return x


def straight(_: Settings, arrays: Arrays) -> None:
    """Say that no edge bends around anything."""
    p = arrays["vertices"]
    middles = 0.5 * (p + np.roll(p, -1, 1))
    arrays["contacts"] = np.stack([middles, middles], axis=2)


def with_text(old: str, new: str) -> Change:
    """Change the problem's text."""

    def change(settings: Settings, _: Arrays) -> None:
        assert old in settings["problem"]
        settings["problem"] = settings["problem"].replace(old, new)

    return change


def pulls(factor: float, where: Any = ...) -> Change:
    """Multiply tensions, also of legs and of the team."""
    own = where[1] if isinstance(where, tuple) else where
    return both(
        times("tensions", factor, where),
        times("leg_tensions", factor, where),
        times("tension", factor, own),
    )


LIES = [
    # Polynomials.
    Lie("morph", "one drone flies 3 cm aside", plus("drones", 0.03, (slice(None), 0, 0)), "cable_length"),
    Lie("morph", "a drone makes a detour within a piece", plus("drones", 0.05, np.s_[10, 1, 2, 3]), "speed|acceleration|jerk"),
    Lie("morph", "a drone jumps by a hundredth of a millimetre", plus("drones", 1e-5, (slice(20, None), 3, 1)), "continuity"),
    Lie("morph", "a drone moves by many small jumps", edited("drones", lambda x: x + 5e-7 * np.arange(len(x))[:, None], np.s_[:, 3, 1]), "continuity"),
    Lie("morph", "a vertex makes a detour", plus("vertices", 0.05, np.s_[10, 0, 0, 3]), "cable_length"),
    Lie("morph", "vertices are lifted", plus("vertices", 0.05, (slice(None), slice(None), 2)), "cable_length"),
    Lie("morph", "all is mirrored", both(*(times(x, -1.0, np.s_[..., 0, :]) for x in ("drones", "vertices", "contacts"))), "convexity"),
    Lie("morph", "two vertices are exchanged", swapped("vertices", 0, 1), "cable_length"),
    Lie("morph", "two drones are exchanged", swapped("drones", 0, 1), "cable_length"),
    Lie("morph", "it is flown backwards", backwards, REFUSED),
    Lie("morph", "nothing moves", hover, REFUSED),
    Lie("morph", "a piece is written twice as long", lambda s, a: a.update(breaks=a["breaks"] + np.where(np.arange(len(a["breaks"])) > 9, 1e-3, 0)), REFUSED),
    Lie("morph", "it takes half of the time", both(times("breaks", 0.5), everywhere("start", lambda t: t / 2), everywhere("end", lambda t: t / 2)), "acceleration"),
    Lie("morph", "it takes twice the time", both(times("breaks", 2.0), everywhere("start", lambda t: 2 * t), everywhere("end", lambda t: 2 * t)), REFUSED),
    Lie("morph", "a piece is cut in two", split, "", "the same curves in other pieces"),
    # Legs, lengths, tensions.
    Lie("morph", "legs are told 1 mm longer", plus("legs", 1e-3), "cable_length"),
    Lie("morph", "a cable is told longer", times("cable_length", 1.01, 0), REFUSED),
    Lie("morph", "a cable is told, and asked, longer", times("cable_length", 1.01, 0), "cable_length"),
    Lie("morph", "tensions are told to be twice as large", times("tensions", 2.0), "tension"),
    Lie("morph", "tensions and those asked are twice as large", both(pulls(2.0), put("problem", ""), put("request", None)), "", "tensions are asked then, and drones can pull so"),
    Lie("morph", "a team's tension is another", times("tension", 1.1), REFUSED),
    Lie("morph", "one cable pulls harder", pulls(1.2, (slice(None), 0)), "equilibrium"),
    Lie("morph", "tensions of no pull", times("tensions", 0.0), "tension"),
    Lie("morph", "a phase allows any tension", both(times("tensions", 1.5), everywhere("tension", [0.1, 9.0])), REFUSED),
    # The team.
    Lie("morph", "drones are told lighter", times("mass", 0.5), REFUSED),
    Lie("morph", "drones are told, and asked, heavier", times("mass", 3.0), "thrust"),
    Lie("morph", "motors are told, and asked, weaker", times("max_thrust", 0.5), "thrust"),
    Lie("morph", "cables have weight", put("team", "cable_density", 0.01), REFUSED),
    Lie("morph", "cables have weight, and were asked to", put("team", "cable_density", 0.03), "equilibrium"),
    Lie("morph", "clasps carry a load", put("team", "load", [0.02] * 3), REFUSED),
    Lie("morph", "clasps carry a load, and were asked to", put("team", "load", [0.02] * 3), "equilibrium"),
    Lie("morph", "friction is told higher", put("team", "cable_friction", 0.3), REFUSED),
    Lie("morph", "friction is told as a range", put("team", "cable_friction", [0.1, 0.3]), REFUSED),
    Lie("morph", "a range of friction ends first", put("team", "cable_friction", [0.3, 0.1]), REFUSED),
    Lie("morph", "an open chain", put("team", "topology", "open"), REFUSED),
    # Limits and what was asked.
    Lie("morph", "a faster limit", put("limits", "speed", 9.0), REFUSED),
    Lie("morph", "a slower limit, asked as well", put("limits", "speed", 0.1), "speed"),
    Lie("morph", "half of all jerk is left for stops, as asked", put("limits", "reserve", 0.5), "jerk"),
    Lie("morph", "less tilt, asked as well", put("limits", "tilt", np.radians(20.0)), "tilt"),
    Lie("morph", "a turning rate, asked as well", put("limits", "body_rate", np.radians(5.0)), "body_rate"),
    Lie("morph", "longer legs, asked as well", put("limits", "leg", 0.5), "legs"),
    Lie("morph", "a duration, asked as well", put("limits", "duration", 1.0), "duration"),
    Lie("morph", "smaller drones", put("separation", "radius", 0.05), REFUSED),
    Lie("morph", "larger drones, asked as well", put("separation", "radius", 0.25), "separation"),
    Lie("morph", "wider crossings, asked as well", put("separation", "crossing", 1.5), "crossing"),
    Lie("morph", "a lower ceiling, asked as well", put("arena", "upper", [4, 4, 0.5]), "arena"),
    Lie("morph", "a wall in the way that nobody asked", put("keep_out", [{"polygon": [[0, 0], [0, 1], [1, 1], [1, 0]], "lower": 0, "upper": 3}]), REFUSED),
    Lie("morph", "a wall in the way, asked", put("keep_out", [{"polygon": [[-1, -1], [-1, 1], [1, 1], [1, -1]], "lower": 0.0, "upper": 3.0}]), "keep_out"),
    Lie("morph", "no problem", removed("problem"), REFUSED),
    Lie("morph", "another start was asked", with_text("altitude: 1", "altitude: 1.1"), REFUSED),
    Lie("morph", "a title", put("title", "another one"), "", "a title is a label"),
    Lie("morph", "phases have other names", everywhere("name", "fly"), "", "names of phases are labels"),
    # Phases.
    Lie("morph", "a phase ends too early", everywhere("end", lambda t: t - 0.1), REFUSED),
    Lie("morph", "cables hang free", everywhere("state", "hanging free"), "consistency"),
    Lie("morph", "it holds what is not there", everywhere("hold", {"object": "box", "by": "rest", "cables": [0]}), REFUSED),
    # Forming.
    Lie("form", "robots fly each other's roles", exchanged, "cable_length"),
    Lie("form", "a robot is turned around", flipped, "cable_length"),
    Lie("unlike", "masses of two roles are exchanged", swapped("mass", 0, 1, 0), REFUSED),
    Lie("unlike", "robots fly each other's roles, masses and all", both(exchanged, swapped("mass", 0, 1, 0)), REFUSED),
    Lie("unlike", "a robot is turned around", flipped, "cable_length"),
    Lie("unlike", "lengths of all roles are shifted", lambda s, a: a.update(cable_length=np.roll(a["cable_length"], 1)), REFUSED),
    Lie("form", "clasping is said to hang free", stated("clasping", "hanging free"), "interlacing"),
    Lie("form", "clasping is said to be tightening", stated("clasping", "being tightened"), "interlacing"),
    Lie("form", "hanging free is said to be on the ground", stated("hanging free", "on the ground"), "consistency"),
    Lie("form", "tightening is said to follow a loss", stated("being tightened", "loose after a loss"), "consistency"),
    Lie("form", "tightening is said to be hitched", stated("being tightened", "hitched"), "cable_length"),
    Lie("form", "tightened cables pull three times as hard", tight, "tension"),
    Lie("form", "the hitch was there at first", everywhere("state", "hitched"), "cable_length"),
    Lie("form", "the hitch is never there", stated("hitched", "being tightened"), "consistency"),
    Lie("form", "the second swap turns back", turned_back, "interlacing"),
    Lie("form", "drones fly 1.4 m lower", both(plus("drones", -1.4, (slice(None), slice(None), 2)), plus("vertices", -1.4, (slice(None), slice(None), 2))), "cable_clearance"),
    Lie("form", "tension is there at once", at_once, "tension"),
    Lie("form", "a drone stands where its own other leg ends", in_phases("hitched", "drones", lambda x: np.stack([x[:, 0], x[:, 0] + [[0.06], [0.0], [0.0]]], axis=1), np.s_[:, :2]), "cable_clearance"),
    # Friction.
    Lie("slid", "legs pull 10 % harder", times("leg_tensions", 1.1), "equilibrium"),
    Lie("slid", "legs pull as their cables", removed("leg_tensions"), REFUSED),
    Lie("slid", "no friction, asked as well", put("team", "cable_friction", 0.0), "equilibrium"),
    # Carrying.
    Lie("carry", "the box floats 5 cm above its clasps", plus("poses", 0.05, (slice(None), 2, 2)), REFUSED),
    Lie("carry", "the box is heavier, asked as well", put("objects", "box", "mass", 0.3), "equilibrium"),
    Lie("carry", "the box bears nothing", times("load_share", 0.0), "consistency"),
    Lie("carry", "nothing is held", everywhere("hold", None), "consistency"),
    Lie("carry", "it is gripped", everywhere("hold", lambda h: h and {**h, "by": "grip"}), "grip|equilibrium|consistency"),
    Lie("carry", "it is held while it is enclosed", everywhere("hold", {"object": "box", "by": "rest", "cables": [0, 1, 2, 3]}, "enclose"), "consistency"),
    Lie("carry", "the box stays where it was", lambda s, a: a.update(poses=np.broadcast_to(a["poses"][:1, ..., :1], a["poses"].shape).copy()), "rim"),
    Lie("carry", "the box turns", turning, REFUSED),
    Lie("carry", "the box turns, less than 0.1 mm a piece", slipped(2, 0.001), "rim"),
    Lie("carry", "the box is left in the air", left_there, "consistency"),
    Lie("carry", "the box is fixed", put("objects", "box", "fixed", True), REFUSED),
    Lie("carry", "a smooth rim, asked as well", put("objects", "box", "friction", 0.01), "rim"),
    Lie("carry", "a smaller rim, asked as well", small_rim, "rim"),
    Lie("carry", "a taller box, asked as well", put("objects", "box", "upper", 0.9), "penetration|support|object_clearance|keep_out"),
    Lie("carry", "objects farther from cables, asked as well", put("separation", "object", 0.2), "object_clearance"),
    Lie("carry", "the box stands in the air at first", lifted, REFUSED),
    Lie("carry", "a pillar is through the rim at first", pierced, "penetration"),
    Lie("carry", "no objects", removed("objects"), REFUSED),
    Lie("grip", "contacts are 2 cm off", plus("contacts", 0.02, (slice(None), 0, 0, 0)), "wrap"),
    Lie("grip", "the drum is heavier, asked as well", put("objects", "drum", "mass", 0.3), "grip"),
    Lie("grip", "the drum is smoother, asked as well", put("objects", "drum", "friction", 0.1), "grip"),
    Lie("grip", "the drum turns in its grip, less than 0.1 mm a piece", slipped(0, 0.001), "wrap"),
    Lie("grip", "the drum sinks by 0.1 mm through its grip", slipped(0, 0.0, 1e-4), "wrap"),
    Lie("grip", "edges run straight", removed("contacts"), REFUSED),
    Lie("grip", "edges are said to be straight", straight, "cable_length|penetration|equilibrium"),
    # Single drones.
    Lie("swarm", "two drones are exchanged", swapped("drones", 0, 1), REFUSED),
    Lie("morph", "the hitch flies 2 m lower", both(plus("drones", -2.0, (slice(None), slice(None), 2)), plus("vertices", -2.0, (slice(None), slice(None), 2))), "floor"),
    Lie("swarm", "drones fly 2 m lower", plus("drones", -2.0, (slice(None), slice(None), 2)), "floor"),
    Lie("swarm", "the floor is lower", put("limits", "floor", -2.0), REFUSED),
    Lie("swarm", "there is no floor", put("limits", "floor", None), REFUSED),
    Lie("swarm", "the floor is above the drones", put("limits", "floor", 9.0), REFUSED),
    Lie("swarm", "two drones fly the same way", lambda s, a: a.update(drones=a["drones"][:, [0, 0, 2, 3, 4, 5]]), "separation"),
    Lie("swarm", "a drone is tied", everywhere("state", "hitched"), REFUSED),
    Lie("chain", "the chain is closed", put("team", "topology", "closed"), REFUSED),
    Lie("chain", "an end of the chain hangs on", plus("legs", 0.1, (slice(None), 0, 0)), "cable_length"),
    Lie("chain", "an end of the chain leaves its point", plus("drones", 0.05, (slice(None), 0, 2)), "consistency|cable_length"),
]  # fmt: skip

PLANS = {
    "morph": "triangle",
    "form": "form_triangle",
    "swarm": "swarms/circle_6",
    "chain": "open_arc",
}

CARRIED = {"carry": "carry_box", "grip": "grip_drum", "slid": "grip_drum"}
"""Of these problems the transport alone, from beside the object, which is verified sooner."""

FRICTION = 0.1  # Of the cables that are slid, against which legs lean as they grip

UNLIKE_TEAM = {
    "robots": 3,
    "cable_length": [2.4, 2.4, 2.6],
    "tension": 0.5,
    "quadrotor": [{"mass": 0.132}, {"mass": 0.14}, {"mass": 0.15, "max_thrust": 2.8}],
}
Q = [[0.9, 0.2, 1.5], [-1.2, -0.6, 1.5], [-0.4, 1.2, 1.5]]
R = [[0.2, -1.2, 1.5], [-1.0, 0.6, 1.5], [0.8, 0.9, 1.5]]
TIED = {"form": {"polygon": [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], "altitude": 1.6}}
UNLIKE = {"team": UNLIKE_TEAM, "start": {"drones": {"q": Q, "r": R}}, "mission": [TIED]}


@lru_cache
def plan(name: str) -> tuple[ho.Plan, str]:
    """Return a plan and the text of its problem."""
    if name in PLANS:
        return planned(PLANS[name]), (PROBLEMS / f"{PLANS[name]}.yaml").read_text()
    problem: Any = UNLIKE
    if name in CARRIED:
        problem = read_yaml(PROBLEMS / f"{CARRIED[name]}.yaml")
        form, transport, *_ = problem["mission"]
        x, y, _ = problem["objects"][transport["transport_object"]["object"]]["at"]
        around = [[x - 0.8 + a, y + b] for a, b in form["form"]["polygon"]]
        start = {"hitch": {"polygon": around, "altitude": form["form"]["altitude"]}}
        problem = {**problem, "start": start, "mission": [transport]}
        if name == "slid":
            problem["team"] = {**problem["team"], "cable_friction": FRICTION}
    return ho.solve(problem_from_dict(problem)), json.dumps(problem)


GROUP = "groups/0/"
OF_ROBOTS = ("cable_length", "tension")
OF_KINDS = ("mass", "max_thrust")


def told(lie: Lie, path: Path) -> None:
    """Write a plan that tells a lie.

    It is told of one mapping with all settings, and of arrays, among them the team's numbers.
    """
    motion, text = plan(lie.plan)[0].motion, plan(lie.plan)[1]
    write_plan(path, ho.Flight.of(motion), "", text)
    with np.load(path) as file:
        arrays = {name.removeprefix(GROUP): file[name] for name in file}
    whole = json.loads(str(arrays.pop("settings")))
    records = whole["groups"][0]["records"]
    team, needs, has_cables = records["team"], records["requirements"], motion.team.has_cables
    settings = {"problem": text, "request": whole["request"], "title": "", **records, **needs}
    arrays |= {name: np.array(team[name]) for name in OF_ROBOTS if has_cables}
    arrays |= {name: np.array([kind[name] for kind in team["quadrotor"]]) for name in OF_KINDS}
    lie.change(settings, arrays)
    team |= {name: arrays.pop(name).tolist() for name in OF_ROBOTS if has_cables}
    for name in OF_KINDS:
        for kind, value in zip(team["quadrotor"], arrays.pop(name).tolist(), strict=True):
            kind[name] = value
    for part in (whole, records, needs):
        keys = [key for key in part if key not in ("groups", "others", "requirements")]
        for key in keys:
            del part[key]
        part |= {key: settings[key] for key in keys if key in settings}
    heads = {"format": arrays.pop("format"), "settings": np.array(json.dumps(whole))}
    np.savez(path, **heads, **{GROUP + name: array for name, array in arrays.items()})


def verdicts(lie: Lie, path: Path) -> Iterator[tuple[str, str]]:
    """Yield limits and their verdicts of a plan that tells a lie."""
    told(lie, path)
    try:
        if lie.found in ("", REFUSED):  # else a limit is broken, whatever was requested
            read_requested_plan(path)
        for row in driver.plan_rows(second.read(path)[0][0]):
            yield row.name, row.verdict
    except (second.UnreadableError, FileError):
        yield REFUSED, "violated"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unlike", *CARRIED])
def test_plans_that_tell_none_are_proven(name: str, tmp_path: Path) -> None:
    """Those of problems as they are: ``test_verify``."""
    honest = Lie(name, "the truth", lambda *_: None, "")
    assert {verdict for _, verdict in verdicts(honest, tmp_path / "plan.npz")} == {"proven"}


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES, ids=lambda lie: f"{lie.plan}: {lie.words}")
def test_lies_are_found(lie: Lie, tmp_path: Path) -> None:
    found = [*verdicts(lie, tmp_path / "plan.npz")]
    if lie.found:
        assert any(
            name in lie.found.split("|") and verdict == "violated" for name, verdict in found
        )
    else:
        assert lie.reason
        assert {verdict for _, verdict in found} == {"proven"}
