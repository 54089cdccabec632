"""Clasps that open while every instant balances, and parts of cables that pass each other."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hitchopt.checks import certify, clasps
from hitchopt.cli import main
from hitchopt.geometry import regular_polygon
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import Motion, Phase, concatenated
from hitchopt.planners.stages import reversed_stages
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.search import worst
from hitchopt.values import Array
from hitchopt.verify import cables, links
from tests.helpers.motions import altered, row, smooth_step, still
from tests.helpers.second_opinions import Rows, opinion_of
from tests.helpers.swaps import stages_of, wrong

OUTLINE = np.array([[-0.4, 0.9], [1.0, 0.9], [1.0, -0.5], [-0.4, -0.5]])
LEGS = np.array([0.36, 0.64, 0.5, 0.5])  # q_1 and r_0 keep off each other where they pass
SPEC = Requirements(Limits(acceleration=5.0), Separation(cable=0.05), None)


def turned(motion: Motion, clasp: int, degrees: float) -> Motion:
    """Turn the pair of a clasp about what its legs pull with, from rest to rest, in balance.

    Of a hitch at rest whose cables weigh nothing; to rounding. Positive angles raise q at first.
    """
    breaks, layout = motion.drones.breaks, motion.team.layout
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * bernstein.nodes(9)
    angle = np.vectorize(smooth_step)((times - breaks[0]) / motion.duration)[..., None]
    angle *= math.radians(degrees)
    place, drones = motion.vertices.coefficients[0, clasp, :, 0], motion.drones.coefficients
    pair = (2 * clasp, 2 * ((clasp - 1) % layout.robots) + 1)
    legs = [drones[0, drone, :, 0] - place for drone in pair]
    sizes = [
        np.linalg.norm(leg) / motion.team.tension[i // 2] for i, leg in zip(pair, legs, strict=True)
    ]
    axis = unit(legs[0] / sizes[0] + legs[1] / sizes[1])

    def change(c: Array) -> None:
        for drone, leg in zip(pair, legs, strict=True):
            on = axis * (axis @ leg)
            around = np.cos(angle) * (leg - on) + np.sin(angle) * np.cross(leg, axis)
            c[:, drone] = bernstein.interpolate((place + on + around).swapaxes(1, 2))

    return altered(replace(motion, drones=motion.drones.elevated(9)), "drones", change)


def square(clasp: int, degrees: float, load: float = 0.0) -> Motion:
    """Return a square hitch, off the origin, one pair of which turns in 40 s."""
    legs = np.roll(LEGS, clasp - 1)
    team = Team(4, 2.4, load=load)
    held = still(team, OUTLINE, legs, seconds=40.0, pieces=48, order=3)
    return turned(replace(held, requirements=SPEC), clasp, degrees)


def unproven(motion: Motion, path: Path, *functions: Rows) -> set[str]:
    """Return the limits that ``verify`` does not prove, by some of its functions or by all."""
    rows = opinion_of(motion, path, *functions)
    return {row.name for row in rows if row.verdict != "proven"}


@pytest.mark.parametrize(
    ("degrees", "clasp", "load"),
    [
        *((-165, 2, 0.01), (180, 0, 0.0), (180, 0, 0.01)),
        *(
            pytest.param(*each, load, marks=pytest.mark.slow)
            for each in ((90, 1), (175.5, 3), (360, 1), (-360, 2), (720, 3))
            for load in (0.0, 0.01)
        ),
    ],
)
def test_a_clasp_that_rolls_open_is_refused(
    degrees: float, clasp: int, load: float, tmp_path: Path
) -> None:
    """All other checks hold, and the worst of equilibrium is the contact."""
    motion, holds = square(clasp, degrees, load), abs(degrees) < 175
    certificate = certify(motion, reports=())
    assert unproven(motion, tmp_path) == (set() if holds else {"contact"})
    assert [check.name for check in certificate.violated] == ([] if holds else ["equilibrium"])
    if not holds:
        check = certificate["equilibrium"]
        vertex, words = check.where
        assert vertex == f"p{clasp}"
        share = smooth_step(check.time / 40.0)
        rolled = math.remainder(degrees * share, 360.0)
        assert abs(rolled) > 165.0
        assert words == f"open at a roll of {rolled:.0f}°"
        if load:
            run = CliRunner().invoke(main, ["check", str(tmp_path)])
            assert run.exit_code == 3
            assert f"{vertex}, {words}" in run.output


@pytest.mark.parametrize(("roll", "holds"), [(174.9, True), (-174.9, True), (175.1, False)])
@pytest.mark.parametrize("tension", [0.5, [0.5, 0.55, 0.5, 0.48]])
def test_a_clasp_is_open_from_a_roll_of_175_degrees_on(
    roll: float, holds: bool, tension: float | list[float]
) -> None:
    motion = still(Team(4, 2.4, tension=tension), OUTLINE, LEGS)
    finer = altered(turned(motion, 1, roll), "drones", lambda c: c[-1:, ..., -1:] + 0.0 * c)
    assert row(finer, "equilibrium").holds is holds


def test_legs_do_not_wind_around_edges_in_contact(tmp_path: Path) -> None:
    """With steep edges, a loaded clasp is closed at every roll: a turn twists its cables."""
    u, load = unit(np.array([[0.92, 0.0, -0.39], [1.0, -0.015, 0.0]])), 0.047
    tension = np.array([1.05, 1.0])
    pull = tension[0] * u[0] - tension[1] * u[1] + [0.0, 0.0, 9.81 * load]
    size = float(np.linalg.norm(pull))
    along = (size**2 + tension[1] ** 2 - tension[0] ** 2) / (2.0 * size)
    v, mean = pull / size, u[0] + u[1]
    ahead = unit(mean - v * (mean @ v)) * math.sqrt(tension[1] ** 2 - along**2)
    q, r = along * v + ahead, ((size - along) * v - ahead) / tension[0]
    points = np.array([1.0, 2.0, 2.0]) + np.array([-1.4 * u[0], 0.0 * v, 1.4 * u[1]])
    drones = np.array([points[0], points[1] + 0.4 * r, points[1] + 0.6 * q, points[2]])
    team = Team(2, [1.8, 2.0], topology="open", tension=tension, load=load)
    lengths = np.array([[0.0, 0.4], [0.6, 0.0]])
    breaks, constant = np.linspace(0.0, 40.0, 49), PiecewisePolynomial.constant
    first, *others = (constant(breaks, part) for part in (drones, points, lengths, tension))
    phases = (Phase("hold", 0, 0.0, 40.0),)
    held = Motion(team, SPEC, first, others[0], others[1], others[2], phases)
    assert row(held, "equilibrium").worst < 1e-9
    motion = turned(held, 1, 360.0)
    assert worst(clasps.Clasps.of(motion), clasps._opening, "max").worst < 0.0
    check = row(motion, "equilibrium")
    assert not check.holds
    assert check.where[1].startswith("open at a roll of")
    assert "contact" in unproven(motion, tmp_path)
    assert unproven(turned(held, 1, 60.0), tmp_path).isdisjoint({"contact", "equilibrium"})


@pytest.mark.parametrize(("degrees", "clasp"), [(360.0, 1), (-360.0, 0), (720.0, 2)])
def test_links_are_followed_through_a_hitch(degrees: float, clasp: int, tmp_path: Path) -> None:
    """Turns of a pair in a hitch are missing or left over when it is released."""
    _, stages = stages_of(4)
    there, back = (turned(stages[-1], clasp, sign * degrees) for sign in (1.0, -1.0))
    assert not wrong(*stages, there, back, *reversed_stages(stages))
    assert not wrong(*stages, there)  # nothing is let go: clasps that bear hold on
    flown = [*stages, there, *reversed_stages(stages)]
    assert wrong(*flown) == {f"p{clasp}"}
    assert unproven(concatenated(flown), tmp_path, links.interlacing) == {"interlacing"}
    joined = concatenated([*stages, there, back, *reversed_stages(stages)])
    assert not unproven(joined, tmp_path, links.interlacing)


@pytest.mark.parametrize(("degrees", "holds"), [(140, True), (160, False), (-160, False)])
def test_loads_open_a_clasp_sooner(degrees: float, holds: bool, tmp_path: Path) -> None:
    """Each cable carries half of the load: contact is only a part of the bending force."""
    motion = square(1, degrees, 0.03)
    assert row(motion, "equilibrium").holds is holds
    assert ("contact" in unproven(motion, tmp_path, cables.taut_cables)) is not holds


def test_touching_parts_fail_for_any_required_distance(tmp_path: Path) -> None:
    """Legs cross in the plane of a hexagon, and a drone touches a foreign edge."""
    asked = Separation(cable=0.0, crossing=0.0)
    crossed = still(Team(6, 2.0), regular_polygon(6, 0.5).vertices, 0.75, separation=asked)
    near = np.mean(crossed.vertices.coefficients[:, [2, 3]], axis=1) + [[0.0], [0.0], [5e-5]]
    motion = altered(crossed, "drones", lambda c: c.__setitem__((slice(None), 0), near))
    left = unproven(motion, tmp_path)
    for name in ("crossing", "cable_clearance"):
        check = row(motion, name)
        assert check.worst == pytest.approx(5e-5 if name == "cable_clearance" else 0.0)
        assert not check.holds
        assert name in left
