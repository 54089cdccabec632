"""What works with what: each refusal is declared, raised in its words, and in the table."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from generators.support_page import write_support_page

import hitchopt as ho
from hitchopt.carrying.enclosing import object_of
from hitchopt.carrying.polygons import grip_clasps
from hitchopt.checks.certifying import certify
from hitchopt.errors import HitchoptError
from hitchopt.exports.held_tension import held_tension
from hitchopt.hitch.requirements import Requirements
from hitchopt.lab.simulation.hitched import fly_hitched
from hitchopt.lab.simulation.settings import Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.statics.tolerance import taut_times
from hitchopt.motion.flight import TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import final_hitch
from hitchopt.planners.optimise.cost import FlightCost
from hitchopt.support import REFUSALS, Feature, Neighbour
from tests.helpers import carried_plans
from tests.helpers.plans import PROBLEMS, ROOT, planned

DIRECT = {
    "errors.py": "optional packages",
    "support.py": "the declaration",
    "exports/format.py": "formats of other packages",
    "exports/exporting.py": "formats of other packages",
    "slices.py": "installations that lack a slice",
    "lab/simulation/exported.py": "files for viewers",
    "live/commands.py": "operating systems",
    "live/links.py": "packages of radios, and parameters on board",
    "view/own_pages.py": "versions of viser",
}
"""Modules that raise an UnsupportedError of their own, and about what: no combination."""


def test_combinations_are_refused_from_the_declaration() -> None:
    package = ROOT / "hitchopt"
    direct = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if "UnsupportedError(" in (text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "UnsupportedError"
    }
    assert direct == DIRECT.keys()


def test_the_table_has_every_refusal() -> None:
    page = write_support_page()
    table = [line.split("|")[1:-1] for line in page.splitlines() if line.startswith("| ")]
    head, *rows = [[cell.strip() for cell in row] for row in table]
    assert head == ["", *Neighbour]
    cells = {
        (row[0], name): cell for row in rows for name, cell in zip(head[1:], row[1:], strict=True)
    }
    assert {pair for pair, cell in cells.items() if cell} == {tuple(map(str, x)) for x in REFUSALS}
    notes = dict(re.findall(r"^(\d+)\. (.+)\.$", page, re.MULTILINE))
    for (feature, neighbour), refusal in REFUSALS.items():
        words = re.sub(r"\{\w+\}", "…", str(refusal))
        assert words in notes[cells[feature, neighbour]]


def triangle() -> Motion:
    return planned("triangle").motion


def swarm() -> ho.Flight:
    return planned("swarms/circle_6").flight


def carrying() -> Motion:
    """Return the motion of a hitch that carries a tray."""
    return carried_plans.plan("tray").motion


def free() -> Motion:
    """Return the part of a triangle's motion on which its cables hang freely."""
    return planned("form_triangle").motion.spans(lambda state: state.hangs)[0]


def loosely_clasped() -> ho.Flight:
    """Return the flight that begins with the stage in which a tied triangle is tightened."""
    motion = planned("form_triangle").motion
    (tightened,) = motion.spans(lambda state: state.tightening)
    return ho.Flight.of(tightened)


def in_company(motion: Motion, neighbour: Neighbour) -> ho.Flight:
    """Return a flight of a motion next to another team or plan, 50 m above the triangle."""
    above = triangle().drones.coefficients + np.array([0.0, 0.0, 50.0])[:, None]
    other = triangle().replaced(drones=replace(triangle().drones, coefficients=above))
    if neighbour == Neighbour.OTHERS:
        return ho.Flight((TeamMotion("", motion),), (TeamMotion("others.show", other),))
    return ho.Flight((TeamMotion("a", motion), TeamMotion("b", other)))


LOADED = ho.Team(3, 2.3, tension=0.7, cable_density=0.01, load=0.01)
CHAIN = ho.Team(3, 2.3, topology="open", cable_density=0.01)
DRUM = ho.load_problem(PROBLEMS / "grip_drum.yaml").objects["drum"]


def held_by(team: ho.Team) -> Any:
    """Return what ``object_of`` reads of the task of a step."""
    requirements = Requirements(objects={"drum": DRUM})
    return SimpleNamespace(requirements=requirements, before=SimpleNamespace(team=team))


def with_team(**values: Any) -> Motion:
    return triangle().replaced(team=replace(triangle().team, **values))


def scene_of(team: ho.Team) -> None:
    start = ho.Hitch.spread(team, ho.regular_polygon(3, 1.0))
    with TemporaryDirectory() as folder:
        ho.solve(start, ho.Hold(0.5)).export("mjcf", Path(folder) / "scene.xml")


def slack() -> Motion:
    tensions = triangle().tensions
    return triangle().replaced(
        tensions=replace(tensions, coefficients=np.zeros_like(tensions.coefficients))
    )


def carrying_time() -> float:
    lift = next(phase for phase in carrying().phases if phase.name == "lift")
    return 0.5 * (lift.start + lift.end)


RAISED: dict[tuple[Feature, Neighbour], Callable[[], object]] = {
    (Feature.HOLDING, Neighbour.CHAINS): lambda: object_of(held_by(CHAIN), "drum"),
    (Feature.GRIPPING, Neighbour.UNEQUAL_KINDS): lambda: next(
        grip_clasps("drum", DRUM, ho.Team(3, [2.3, 2.3, 2.4]), Requirements())
    ),
    (Feature.COST, Neighbour.CHAINS): lambda: FlightCost(CHAIN, lambda _, s: s),
    (Feature.END, Neighbour.SINGLE_DRONES): lambda: final_hitch(swarm().teams[0].motion),
    (Feature.END, Neighbour.FREE_CABLES): lambda: final_hitch(free()),
    (Feature.END, Neighbour.OTHER_TENSIONS): lambda: final_hitch(
        with_team(tension=[0.3, 0.6, 0.9])
    ),
    (Feature.REPLANNER, Neighbour.SINGLE_DRONES): lambda: ho.Replanner(
        triangle().team, planned("swarms/circle_6")
    ),
    (Feature.REPLANNER, Neighbour.FREE_CABLES): lambda: ho.Replanner(
        free().team, ho.Plan(ho.Flight.of(free()), certify(free()), "free")
    ),
    (Feature.HOLD_TENSION, Neighbour.SINGLE_DRONES): lambda: held_tension(swarm()),
    (Feature.HOLD_TENSION, Neighbour.INTEGRAL_GAINS): lambda: held_tension(
        ho.Flight.of(with_team(quadrotor=ho.Quadrotor(controller="mellinger")))
    ),
    (Feature.PLAYER, Neighbour.OTHERS): lambda: ho.Player(in_company(triangle(), Neighbour.OTHERS)),
    (Feature.SURVIVING, Neighbour.OBJECTS): lambda: Requirements(
        ho.Limits(survive="cable"), objects={"drum": DRUM}
    ).flown_by(ho.Team(3, 2.4, release=True, quadrotor="paper_132g")),
    (Feature.STATICS, Neighbour.SINGLE_DRONES): lambda: taut_times(swarm().teams[0].motion),
    (Feature.STATICS, Neighbour.FREE_CABLES): lambda: taut_times(slack()),
    (Feature.STATICS, Neighbour.OBJECTS): lambda: ho.equilibrium(carrying(), carrying_time()),
    (Feature.SCENE, Neighbour.LOADS): lambda: scene_of(LOADED),
    (Feature.CLASPS, Neighbour.OBJECTS): lambda: fly_hitched(
        Task.of(ho.Flight.of(carrying())), Settings(), [0]
    ),
    (Feature.SIMULATION, Neighbour.SINGLE_DRONES): lambda: Task.of(swarm()),
    (Feature.SIMULATION, Neighbour.LOOSE_CLASPS): lambda: Task.of(loosely_clasped()),
}
"""A refused call of each combination, but those that ``Flight.of_one_team`` refuses."""


@pytest.mark.parametrize(("feature", "neighbour"), REFUSALS)
def test_each_combination_is_refused_in_its_words(feature: Feature, neighbour: Neighbour) -> None:
    def of_one_team() -> object:
        return in_company(triangle(), neighbour).of_one_team(feature)

    words = re.sub(r"\\\{\w+\\\}", ".*", re.escape(str(REFUSALS[feature, neighbour])))
    with pytest.raises(HitchoptError, match=words):
        RAISED.get((feature, neighbour), of_one_team)()
