"""Files of several groups come back bit by bit, are proven twice, and their lies are refused."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks import certify
from hitchopt.checks.certifying import check_of
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.spans import magnitude
from hitchopt.cli import main
from hitchopt.errors import FileError, InputError
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.motion.request import check_request, request_of
from hitchopt.teams.across import check_across
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from hitchopt.verify import drones, teams
from tests.helpers.groups import beside_saved, moved, with_swarm
from tests.helpers.plans import planned
from tests.helpers.second_opinions import opinion, violated

Change = Callable[[dict[str, Any], dict[str, Any]], object]


def pillar(x: float, *, slides: float = 0.0) -> Motion:
    """Return two single drones far away, with a pillar that stands in the way, or slides."""
    whole = planned("form_square").motion
    body = ho.SolidObject(ho.Section(radius=0.1), 0.0, 1.0, at=[x, 2.0, 0.0], mass=0.1)
    start = np.array([[x + 9.0, 0.0, 1.0], [x + 9.0, 2.0, 1.0]])
    drones = PiecewisePolynomial.constant(whole.drones.breaks[[0, -1]], start)
    requirements = replace(whole.requirements, objects={"pillar": body})
    phases = [replace(whole.phases[0], start=0.0, end=whole.duration)]
    single = Motion.single(ho.Swarm(2), requirements, drones, phases)
    poses = np.stack([body.pose, body.pose + [0.0, slides, 0.0, 0.0, 0.0]], axis=-1)[None, None]
    return single.replaced(poses=PiecewisePolynomial(drones.breaks, poses))


OBJECTS = {"pillars near each other": 2.4, "pillars near cables": -2.0}
"""Where the second one stands [m]."""


def plan(name: str, folder: Path) -> Flight:
    """Return a flight by its name."""
    if name == "beside":
        return beside_saved(folder)
    if name in OBJECTS:
        groups = [TeamMotion("a", pillar(1.9)), TeamMotion("b", pillar(OBJECTS[name], slides=0.4))]
        return Flight((*groups, TeamMotion("tied", planned("form_square").motion)))
    return with_swarm() if name == "swarm" else planned(f"two_{name}").flight


@pytest.mark.parametrize("name", ["teams", "layers", "beside", "swarm", *OBJECTS])
def test_distances_across_agree(name: str, tmp_path: Path) -> None:
    flight = plan(name, tmp_path)
    write_plan(tmp_path / "plan.npz", flight)
    own, others = second.read(tmp_path / "plan.npz")
    found: dict[str, float] = {}
    separation = vars(flight.requirements.separation)
    for p, q in combinations([*own, *others], 2):
        for one, two in ((p, q), (q, p)) if p in own else ():
            pair = teams.Pair(one, two, separation, (0.0, 0.0))
            for row in (*teams.between_plans(pair), *teams.object_distances(pair)):
                if row.samples:
                    found[row.name] = min(found.get(row.name, np.inf), row.worst)
    checks = {rule: check_across(RULE_OF[rule], flight) for rule in DISTANCES}
    worst = {rule: check.worst for rule, check in checks.items() if check is not None}
    assert found.keys() == worst.keys()
    assert len(worst) == (3 if name == "swarm" else 5 if name in OBJECTS else 4)
    for rule, value in worst.items():
        assert found[rule] == pytest.approx(value, rel=0.01)


def records(settings: dict[str, Any], index: int) -> dict[str, Any]:
    """Return the records of a team: 0 is a, 1 is b."""
    found: dict[str, Any] = settings["groups"][index]["records"]
    return found


def later(settings: dict[str, Any], arrays: dict[str, Any]) -> None:
    for phase in records(settings, 1)["phases"]:
        phase["start"], phase["end"] = phase["start"] + 1.0, phase["end"] + 1.0
    arrays["groups/1/breaks"] = arrays["groups/1/breaks"] + 1.0


def longer(settings: dict[str, Any], arrays: dict[str, Any]) -> None:
    records(settings, 1)["phases"][-1]["end"] += 1.0
    breaks = arrays["groups/1/breaks"]
    arrays["groups/1/breaks"] = breaks + np.append(np.zeros(len(breaks) - 1), 1.0)


def drifts(_: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Let a team that waits for the other one move aside, and back."""
    last = arrays["groups/0/drones"][-1].copy()
    last[:, 0, 3:-3] += 0.01
    arrays["groups/0/drones"] = np.concatenate([arrays["groups/0/drones"][:-1], last[None]])


def stricter(key: str, name: str, value: float) -> Change:
    """Set a limit of team b."""
    return lambda settings, _: records(settings, 1)["requirements"][key].update({name: value})


def renamed(name: str) -> Change:
    """Give team b another name."""
    return lambda settings, _: settings["groups"][1].update(name=name)


def other(**values: Any) -> Change:
    """Change what is stated of a plan that flies besides."""
    return lambda settings, _: settings["others"][0].update(values)


LIES: dict[str, Change] = {
    "a hitch is missing": lambda s, _: s["groups"].pop(1),
    "a team twice": lambda s, _: s["groups"].__setitem__(1, s["groups"][0]),
    "a team flies later": later,
    "a team flies longer": longer,
    "what waits moves": drifts,
    "a flight is called a wait": lambda s, _: records(s, 0)["phases"][0].update(name="wait"),
    "an unknown key": lambda s, _: s.update(colour="red"),
    "an unknown key of a team": lambda s, _: records(s, 0).update(colour="red"),
    "a team has a title": lambda s, _: s["groups"][0].update(title="red"),
    "a team is from another plan": lambda s, _: s["groups"][0].update(digest="0" * 64),
    "no others are told": lambda s, _: s.pop("others"),
    "an array is missing": lambda _, a: a.pop("groups/1/vertices"),
    "single precision": lambda _, a: a.update({"groups/1/legs": np.float32(a["groups/1/legs"])}),
    "a name with a stroke": renamed("b/c"),
    "a name with a dot": renamed("b.c"),
    "no name": renamed(""),
    "a name of others": renamed("others"),
    "a name in capitals": renamed("A"),
    "a problem that is no text": lambda s, _: s.update(problem=3),
}
LIES_BESIDE: dict[str, Change] = {
    "nothing is left": lambda s, _: s.update(groups=[], others=[]),
    "a team's name": lambda s, _: s["groups"][0].update(name="a"),
    "an other without its digest": lambda s, _: s["others"][0].pop("digest"),
    "a digest that is none": other(digest=3),
    "a path that is none": other(plan=None),
    "an other's path twice": other(path="show"),
    "an other far away": lambda _, a: a["others/0/drones"].__iadd__(2e5),
}
BROKEN = {
    "speed": stricter("limits", "speed", 0.4),
    "separation": stricter("separation", "radius", 0.2),
    "crossing": stricter("separation", "crossing", 0.48),
    "cable_clearance": stricter("separation", "cable", 0.5),
}
"""Limits that are stricter in one team, which both then break."""


def second_size(motion: Motion) -> float:
    """Return the largest coordinate by which the second opinion rounds [m]."""
    with TemporaryDirectory() as folder:
        write_plan(path := Path(folder) / "plan.npz", ho.Flight.of(motion))
        return float(second.read(path)[0][0].size)


def told(name: str, change: Change, folder: Path) -> Path:
    """Write a plan, change its file, and return it."""
    path = folder / "plan.npz"
    write_plan(path, plan(name, folder), problem="text")
    with np.load(path) as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    change(settings, arrays)
    np.savez(path, **{**arrays, "settings": np.array(json.dumps(settings))})
    return path


@pytest.mark.parametrize("lie", [*LIES, *LIES_BESIDE])
def test_lies_about_groups_are_refused(lie: str, tmp_path: Path) -> None:
    name, lies = ("teams", LIES) if lie in LIES else ("beside", LIES_BESIDE)
    path = told(name, lies[lie], tmp_path)
    with pytest.raises(FileError):
        read_plan(path)
    with pytest.raises(second.UnreadableError):
        second.read(path)


def negative(value: Any) -> Any:
    """Return a number, or numbers, with the other sign."""
    return (-np.array(value)).tolist()


NUMBERS: dict[str, Change] = {
    "negative lengths": lambda s, _: records(s, 0)["team"].update(
        cable_length=negative(records(s, 0)["team"]["cable_length"])
    ),
    "negative thrusts": lambda s, _: records(s, 0)["team"]["quadrotor"][0].update(max_thrust=-2.6),
    "a degree that overflows": lambda _, a: a.update(
        {"groups/0/drones": np.repeat(a["groups/0/drones"][..., :1], 1101, axis=-1)}
    ),
}


@pytest.mark.parametrize("lie", NUMBERS)
def test_numbers_beyond_their_bounds_are_refused(lie: str, tmp_path: Path) -> None:
    path = told("teams", NUMBERS[lie], tmp_path)
    with pytest.raises(FileError):
        read_plan(path)
    with pytest.raises(second.UnreadableError, match=r"beyond their bounds|not of the type \+"):
        second.read(path)


def test_what_is_twice_in_a_file_is_refused(tmp_path: Path) -> None:
    path = told("teams", lambda *_: None, tmp_path)
    with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.writestr("settings.npy", file.read("settings.npy"))
    with pytest.raises(FileError):
        read_plan(path)
    with pytest.raises(second.UnreadableError, match="occurs twice"):
        second.read(path)


MEMBERS = [
    "groups/0/drones",
    "groups/0/drones.NPY",
    "groups/0/Drones.npy",
    "Groups/0/drones.npy",
    "groups\\0\\drones.npy",
    "groups/0//drones.npy",
    "./groups/0/drones.npy",
    "groups/0/./drones.npy",
    "groups/1/../../groups/0/drones.npy",
    "/groups/0/drones.npy",
    "groups/0./drones.npy",
    "groups/0/drones.npy.",
    "groups/0/drones.npy ",
    "groups/0/drones.npy.npy",
    "groups/0/dr\uff4fnes.npy",
    "groups/0/dro\u200bnes.npy",
    "groups/0/drones/",
    "groups/0/",
    "groups/0/drones.npy",
]
"""Names that numpy, or readers that ignore case or normalise names, take for drones of a team."""


@pytest.mark.parametrize("name", MEMBERS)
@pytest.mark.parametrize("first", [False, True])
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_members_that_readers_may_confuse_are_refused(
    name: str, tmp_path: Path, *, first: bool
) -> None:
    honest, path = tmp_path / "honest.npz", tmp_path / "plan.npz"
    write_plan(honest, plan("pillars near each other", tmp_path))
    with zipfile.ZipFile(honest) as source, zipfile.ZipFile(path, "w") as file:
        members = [(x.filename, source.read(x)) for x in source.infolist()]
        other = (name, source.read("groups/1/drones.npy"))
        for member, data in (other, *members) if first else (*members, other):
            file.writestr(member, data)
    with pytest.raises(FileError, match=r"not the name of an array|readers may confuse"):
        read_plan(path)
    with pytest.raises(second.UnreadableError, match=r"not the name of an array|occurs twice"):
        second.read(path)
    for command in ("check", "verify"):
        assert CliRunner().invoke(main, [command, str(tmp_path)]).exit_code == 2


def test_names_that_differ_by_their_case_alone_are_refused() -> None:
    one, other = pillar(1.9), pillar(5.0)
    for names in (("a", "A"), ("a", "\uff41"), ("Others", "a")):
        with pytest.raises(InputError, match="regardless of case"):
            Flight((TeamMotion(names[0], one), TeamMotion(names[1], other)))


def test_vertices_without_a_hitch_widen_no_tolerance() -> None:
    motion = planned("form_square").motion
    far = motion.vertices.coefficients + 9e4 * ~motion.formed[:, None, None, None]
    moved = motion.replaced(vertices=motion.vertices.replaced(far))
    assert magnitude(moved) == magnitude(motion) < 10.0
    assert second_size(moved) == second_size(motion)


def jumping(c: Array) -> Array:
    """Return curves of drones that are 1 m higher on the last piece."""
    c[-1, 0, 2] += 1.0
    return c


def flying(c: Array) -> Array:
    """Return curves whose last piece ends in flight."""
    c[-1, 0, 2, -2] -= 1e-4
    return c


@pytest.mark.parametrize("change", [jumping, flying])
def test_others_are_continuous_and_at_rest_at_their_ends(
    change: Callable[[Array], Array], tmp_path: Path
) -> None:
    whole = plan("beside", tmp_path)
    group, *rest = whole.others
    c = change(group.motion.drones.coefficients.copy())
    turned = group.motion.replaced(drones=group.motion.drones.replaced(c))
    path = tmp_path / "plan.npz"
    write_plan(
        path,
        replace(whole, others=(replace(group, motion=turned), *rest)),
        problem="text",
    )
    assert [check.name for check in certify(read_plan(path)).violated] == ["continuity"]
    wrong = {row.name for row in second.verify(path) if row.verdict == "violated"}
    assert "continuity" in wrong


@pytest.mark.parametrize("limit", BROKEN)
def test_broken_limits_of_one_team_are_found(limit: str, tmp_path: Path) -> None:
    path = told("teams", BROKEN[limit], tmp_path)
    check = check_of(RULE_OF[limit], read_plan(path))
    assert check is not None
    assert not check.holds
    rows = drones.drones if limit == "speed" else teams.between_plans
    assert limit in violated(opinion(path, rows))


def test_paths_that_collide_are_found(tmp_path: Path) -> None:
    """Both fly at once at one height."""
    a, b = planned("two_layers").flight.teams
    flight = Flight((a, TeamMotion("b", moved(b.motion, 0.0, 0.0, -0.8))))
    write_plan(tmp_path / "plan.npz", flight)
    broken = {row.name for row in second.verify(tmp_path) if row.verdict == "violated"}
    assert broken == {check.name for check in certify(flight, reports=()).violated}
    assert broken == {"separation", "cable_clearance", "crossing", "downwash"}


def asked_of(motion: Motion) -> dict[str, Any]:
    """Return the start and requirements of a motion as a problem's text gives them."""
    return request_of(motion)


def test_every_team_is_compared_with_its_own_request(tmp_path: Path) -> None:
    flight, besides = planned("two_teams").flight, beside_saved(tmp_path)
    a, b = flight.teams
    exchanged = Flight((replace(b, name="a"), replace(a, name="b")))
    needs = b.motion.requirements
    needs = replace(needs, limits=replace(needs.limits, speed=9.0))
    faster = b.motion.replaced(requirements=needs)
    wider = Flight((a, replace(b, motion=faster)))
    teams = {each.name: asked_of(each.motion) for each in flight.teams}
    show, pair = {"plan": "show", "at": 1.7}, {"plan": "pair", "at": -2.1}
    alone = {**asked_of(besides.teams[0].motion), "others": {"show": show, "pair": pair}}
    check_request(teams, flight)
    check_request(alone, besides)
    wrong: list[tuple[dict[str, Any], Flight]] = [
        (teams, exchanged),
        (teams, wider),
        ({"a": teams["a"]}, flight),
        ({**teams, "c": teams["b"]}, flight),
        ({**teams, "others": {"show": show}}, flight),
        (alone, replace(besides, others=besides.others[1:])),
        ({**alone, "others": {"show": show}}, besides),
        ({**alone, "others": {"show": {**show, "at": 2.0}, "pair": pair}}, besides),
    ]
    for wanted, flown in wrong:
        with pytest.raises(InputError, match="request"):
            check_request(wanted, flown)


def test_check_looks_up_what_flies_besides(tmp_path: Path) -> None:
    flight, folder = beside_saved(tmp_path), tmp_path / "plan"

    def checked(flight: Flight) -> tuple[int, str]:
        folder.mkdir(exist_ok=True)
        write_plan(folder / "plan.npz", flight)
        run = CliRunner().invoke(main, ["check", str(folder)])
        return run.exit_code, run.output

    assert checked(flight)[0] == 0
    show, *pair = flight.others
    higher = replace(show, motion=moved(show.motion, 0.0, 0.0, 0.5))
    for other in (replace(show, digest="0" * 64), higher):
        code, words = checked(replace(flight, others=(other, *pair)))
        assert code == 3
        assert "show (show): " in words
        assert "is a different plan" in words
    shutil.rmtree(tmp_path / "pair")
    code, words = checked(flight)
    assert code == 3
    assert words.count("its plan is missing") == 2  # groups of it
    assert "pair.b (pair): " in words


@pytest.mark.parametrize(
    "names", [("a", "a"), ("a", ""), ("a", "b c"), ("others", "b"), ("a", "b.c")]
)
def test_groups_have_names_of_their_own(names: tuple[str, str]) -> None:
    pair = zip(planned("two_teams").flight.teams, names, strict=True)
    groups = [replace(each, name=name) for each, name in pair]
    with pytest.raises(InputError, match="teams"):
        Flight(tuple(groups))
