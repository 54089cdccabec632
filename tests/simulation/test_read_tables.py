"""Tables read back are what was written; broken ones are refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scripted import regular_hitch, standing

from hitchopt.errors import FileError
from hitchopt.export.setpoints import HEADER, write_setpoints
from hitchopt.export.vertices import write_vertices
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Team
from hitchopt.model.motion import Motion, Phase
from hitchopt.requirements import Limits, Requirements, Separation
from hitchopt.simulation.setpoint_tables import read_setpoints, read_vertices
from hitchopt.trajectory import PiecewisePolynomial


def made(topology: str = "closed", *, formed: bool = True) -> Motion:
    """A hitch that drifts and rises, off the origin."""
    points = [[1.2, 0.7], [0.9, 1.9], [2.0, 2.3], [2.6, 1.1]]
    team = Team(4 if topology == "closed" else 3, 2.6, topology=topology, tension=0.47)
    hitch = Hitch.balanced(team, points if topology == "open" else ConvexPolygon(points), 1.1)
    drift = np.array([0.3, -0.2, 0.1])

    def line(values: np.ndarray) -> PiecewisePolynomial:
        ends = np.stack([values, values + drift], axis=-1)
        return PiecewisePolynomial(np.array([0.0, 0.53]), ends[None])

    return Motion(
        team,
        Requirements(Limits(), Separation(), None),
        line(hitch.drones),
        line(hitch.vertices),
        PiecewisePolynomial.constant([0.0, 0.53], hitch.legs, 1),
        PiecewisePolynomial.constant([0.0, 0.53], team.tension, 1),
        (Phase("hold", 0, 0.0, 0.53, formed=formed),),
    )


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_what_was_written_is_read(tmp_path: Path, topology: str) -> None:
    from hitchopt.export.sampling import states_at

    motion = made(topology)
    write_setpoints(tmp_path / "s.csv", motion, 50.0)
    write_vertices(tmp_path / "v.csv", motion, 50.0)
    found = read_setpoints(tmp_path / "s.csv", motion.team)
    np.testing.assert_allclose(found.t, [*np.arange(27) / 50.0, 0.53])
    states = states_at(motion, found.t)
    for name in ("positions", "velocities", "accelerations", "jerks", "cable_forces"):
        np.testing.assert_allclose(getattr(found, name), getattr(states, name), atol=1e-9)
    np.testing.assert_array_equal(found.yaw, 0.0)
    vertices = read_vertices(tmp_path / "v.csv", motion.team)
    np.testing.assert_allclose(vertices.positions, states.vertices, atol=1e-9)
    np.testing.assert_allclose(vertices.tensions, states.tensions)
    assert vertices.index(0.53) == 27
    assert vertices.index(0.525) is None


def test_a_plan_without_a_hitch_has_an_empty_table(tmp_path: Path) -> None:
    motion = made(formed=False)
    write_vertices(tmp_path / "v.csv", motion, 50.0)
    found = read_vertices(tmp_path / "v.csv", motion.team)
    assert found.positions.shape == (0, 4, 3)
    assert found.index(0.0) is None


def test_setpoints_hold_until_the_next_one() -> None:
    setpoints, _ = standing(regular_hitch(3), 0.05)
    for elapsed, index in ((-1.0, 0), (0.0, 0), (0.0099, 0), (0.01, 1), (0.029999999, 3), (9.0, 5)):
        assert setpoints.index(elapsed) == index


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines: ["t,drone", *lines[1:]], "begins with 't,drone'"),
        (lambda lines: lines[:-1], "rows for 8 drones"),
        (lambda lines: [lines[0], lines[2], lines[1], *lines[3:]], "row 1 is of 'r0'"),
        (lambda lines: [lines[0], *lines[9:], *lines[1:9]], "by time, then drone"),
        (
            lambda lines: [*lines[:5], lines[5].replace(",", ",x", 1), *lines[6:]],
            "row 5 is of 'xq2'",
        ),
        (lambda lines: [*lines[:5], "nan" + lines[5], *lines[6:]], "not a table of numbers"),
        (lambda lines: lines[:1], "0 rows for 8 drones"),
    ],
)
def test_broken_tables_are_refused(tmp_path: Path, change: object, words: str) -> None:
    path = tmp_path / "setpoints.csv"
    write_setpoints(path, made(), 50.0)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == HEADER
    assert callable(change)
    path.write_text("\n".join(change(lines)) + "\n", encoding="utf-8")
    with pytest.raises(FileError, match=words):
        read_setpoints(path, made().team)


def test_a_missing_table_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="there is no such file; solve the problem first"):
        read_vertices(tmp_path / "vertices.csv", made().team)


def test_a_table_of_another_team_is_refused(tmp_path: Path) -> None:
    write_vertices(tmp_path / "v.csv", made("open"), 50.0)
    with pytest.raises(FileError, match="not of one solve"):
        read_vertices(tmp_path / "v.csv", Team(5, 2.6))
