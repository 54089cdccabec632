"""Tables are read as they were written; broken ones are refused by name."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from hitchopt.errors import FileError
from hitchopt.exports.directory import HEADER, write_setpoints, write_vertices
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.motion.states import states_at
from hitchopt.simulation.task import Task, read_tables
from hitchopt.trajectory import PiecewisePolynomial


def made(topology: str = "closed", *, formed: bool = True) -> Motion:
    """Return the plan of a hitch that drifts and rises, off the origin."""
    points = [[1.2, 0.7], [0.9, 1.9], [2.0, 2.3], [2.6, 1.1]]
    team = Team(4 if topology == "closed" else 3, 2.6, topology=topology, tension=0.47)
    hitch = Hitch.balanced(team, points if topology == "open" else ConvexPolygon(points), 1.1)
    drift = np.array([0.3, -0.2, 0.1])

    def drifting(values: np.ndarray) -> PiecewisePolynomial:
        shares = np.array([0.0, 0.1, 0.7, 1.0])  # no derivative is zero
        coefficients = values[..., None] + drift[:, None] * shares
        return PiecewisePolynomial(np.array([0.0, 0.53]), coefficients[None])

    state = CableState.HITCHED if formed else CableState.FREE
    return Motion(
        team,
        Requirements(Limits(), Separation(), None),
        drifting(hitch.drones),
        drifting(hitch.vertices),
        PiecewisePolynomial.constant([0.0, 0.53], hitch.legs, 1),
        PiecewisePolynomial.constant([0.0, 0.53], team.tension, 1),
        (Phase("hold", 0, 0.0, 0.53, state=state),),
    )


def written(directory: Path, motion: Motion) -> tuple[Path, Path]:
    places = directory / "setpoints.csv", directory / "vertices.csv"
    write_setpoints(places[0], motion, 50.0)
    write_vertices(places[1], motion, 50.0)
    return places


def read(directory: Path, motion: Motion) -> Task:
    return read_tables(*written(directory, motion), motion.team)


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_what_was_written_is_read(tmp_path: Path, topology: str) -> None:
    motion = made(topology)
    found = read(tmp_path, motion)
    np.testing.assert_allclose(found.t, [*np.arange(27) / 50.0, 0.53])
    states = states_at(motion, found.t)
    for name in ("positions", "velocities", "accelerations", "jerks", "cable_forces"):
        np.testing.assert_allclose(getattr(found.setpoints, name), getattr(states, name), atol=1e-9)
    np.testing.assert_array_equal(found.setpoints.yaw, 0.0)
    assert found.formed.all()
    np.testing.assert_allclose(found.vertices, states.vertices, atol=1e-9)
    np.testing.assert_allclose(found.tensions, states.tensions)
    digest = hashlib.sha256((tmp_path / "setpoints.csv").read_bytes()).hexdigest()
    assert found.digest == digest


def test_a_hitch_is_read_at_the_times_at_which_it_exists(tmp_path: Path) -> None:
    setpoints, vertices = written(tmp_path, made("open"))
    lines = vertices.read_text(encoding="utf-8").splitlines()
    vertices.write_text("\n".join([lines[0], *lines[9:]]) + "\n", encoding="utf-8")
    found = read_tables(setpoints, vertices, made("open").team)
    np.testing.assert_array_equal(np.flatnonzero(~found.formed), [0, 1])
    np.testing.assert_array_equal(found.vertices[:2], 0.0)
    np.testing.assert_allclose(found.vertices[2], states_at(made("open"), 0.04).vertices, atol=1e-9)


def test_tables_of_different_rates_are_refused(tmp_path: Path) -> None:
    setpoints, vertices = written(tmp_path, made())
    write_vertices(vertices, made(), 70.0)
    with pytest.raises(FileError, match=r"vertices\.csv: holds times that setpoints\.csv has not"):
        read_tables(setpoints, vertices, made().team)


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
        (
            lambda lines: [*lines[:5], lines[5].rsplit(",", 1)[0] + ",inf", *lines[6:]],
            "holds numbers that are not finite",
        ),
    ],
)
def test_broken_tables_are_refused(tmp_path: Path, change: object, words: str) -> None:
    path, vertices = written(tmp_path, made())
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == HEADER
    assert callable(change)
    path.write_text("\n".join(change(lines)) + "\n", encoding="utf-8")
    with pytest.raises(FileError, match=words):
        read_tables(path, vertices, made().team)


def test_a_table_of_another_team_is_refused(tmp_path: Path) -> None:
    places = written(tmp_path, made("open"))
    with pytest.raises(FileError, match=r"setpoints\.csv: row 7 .* not of one solve"):
        read_tables(*places, Team(5, 2.6))
    write_setpoints(places[0], made(), 50.0)  # 4 robots have 4 points, as the chain of 3 has
    write_vertices(places[1], made(), 50.0)
    places[1].write_text(places[1].read_text(encoding="utf-8").replace(",3,", ",4,"), "utf-8")
    with pytest.raises(FileError, match=r"vertices\.csv: row 4 .* not of one solve"):
        read_tables(*places, made().team)
