"""Tables are read as they were written; broken ones are refused by name."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hitchopt.errors import FileError
from hitchopt.exports.directory import HEADER, write_setpoints, write_vertices
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import Motion, Phase
from hitchopt.simulation.task import Task, read_tables
from hitchopt.trajectory import PiecewisePolynomial


def made(topology: str = "closed") -> Motion:
    """Return the plan of a hitch that drifts and rises, off the origin."""
    points = [[1.2, 0.7], [0.9, 1.9], [2.0, 2.3], [2.6, 1.1]]
    team = Team(4 if topology == "closed" else 3, 2.6, topology=topology, tension=0.47)
    hitch = Hitch.balanced(team, points if topology == "open" else ConvexPolygon(points), 1.1)

    def drifting(values: np.ndarray) -> PiecewisePolynomial:
        shares = np.array([0.0, 0.1, 0.7, 1.0])  # no derivative is zero
        coefficients = values[..., None] + np.array([0.3, -0.2, 0.1])[:, None] * shares
        return PiecewisePolynomial(np.array([0.0, 0.53]), coefficients[None])

    return Motion(
        team,
        Requirements(Limits(), Separation(), None),
        drifting(hitch.drones),
        drifting(hitch.vertices),
        PiecewisePolynomial.constant([0.0, 0.53], hitch.legs, 1),
        PiecewisePolynomial.constant([0.0, 0.53], team.tension, 1),
        (Phase("hold", 0, 0.0, 0.53),),
    )


@pytest.fixture(params=["closed", "open"])
def written(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Motion, Path, Path]:
    """A plan, and its tables at 50 Hz."""
    motion, places = made(request.param), (tmp_path / "setpoints.csv", tmp_path / "vertices.csv")
    write_setpoints(places[0], motion, 50.0)
    write_vertices(places[1], motion, 50.0)
    return motion, *places


def test_what_was_written_is_read(written: tuple[Motion, Path, Path]) -> None:
    motion, setpoints, vertices = written
    times = np.array([*np.arange(27) / 50.0, 0.53])
    found, sampled = read_tables(setpoints, vertices, motion.team), Task.of(motion, times)
    np.testing.assert_allclose(found.t, times)
    for name, values in vars(sampled.setpoints).items():
        np.testing.assert_allclose(getattr(found.setpoints, name), values, atol=1e-9)
    for name in ("vertices", "tensions", "formed"):
        np.testing.assert_allclose(getattr(found, name), getattr(sampled, name), atol=1e-9)
    assert found.digest == hashlib.sha256(setpoints.read_bytes()).hexdigest()
    lines, points = vertices.read_text(encoding="utf-8").splitlines(), motion.team.layout.points
    vertices.write_text("\n".join([lines[0], *lines[1 + 2 * points :]]) + "\n", encoding="utf-8")
    late = read_tables(setpoints, vertices, motion.team)
    np.testing.assert_array_equal(np.flatnonzero(~late.formed), [0, 1])
    np.testing.assert_array_equal(late.vertices[:2], 0.0)
    np.testing.assert_array_equal(late.vertices[2:], found.vertices[2:])


BROKEN: list[tuple[Callable[[list[str]], list[str]], str]] = [
    (lambda lines: ["t,drone", *lines[1:]], "begins with 't,drone'"),
    (lambda lines: lines[:-1], "rows for . drones"),
    (lambda lines: [lines[0], lines[2], lines[1], *lines[3:]], "row 1 is of 'r0'"),
    (lambda lines: [lines[0], *lines[25:], *lines[1:25]], "by time, then drone"),
    (lambda lines: [*lines[:5], lines[5].replace(",", ",x", 1), *lines[6:]], "row 5 is of 'xq2'"),
    (lambda lines: [*lines[:5], "nan" + lines[5], *lines[6:]], "not a table of numbers"),
    (lambda lines: lines[:1], "0 rows for . drones"),
    (lambda lines: [*lines[:5], lines[5].rsplit(",", 1)[0] + ",inf", *lines[6:]], "not finite"),
]


def test_broken_tables_are_refused(written: tuple[Motion, Path, Path]) -> None:
    motion, path, vertices = written
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == HEADER
    for change, words in BROKEN:
        path.write_text("\n".join(change(lines)) + "\n", encoding="utf-8")
        with pytest.raises(FileError, match=words):
            read_tables(path, vertices, motion.team)


def test_tables_that_are_not_of_one_plan_are_refused(written: tuple[Motion, Path, Path]) -> None:
    motion, setpoints, vertices = written
    with pytest.raises(FileError, match=r"setpoints\.csv: row \d .* not of one solve"):
        read_tables(setpoints, vertices, Team(5, 2.6))
    text = vertices.read_text(encoding="utf-8")
    vertices.write_text(text.replace(",3,", ",4,"), "utf-8")
    with pytest.raises(FileError, match=r"vertices\.csv: row 4 .* not of one solve"):
        read_tables(setpoints, vertices, motion.team)
    write_vertices(vertices, motion, 70.0)
    with pytest.raises(FileError, match=r"vertices\.csv: holds times that setpoints\.csv has not"):
        read_tables(setpoints, vertices, motion.team)
