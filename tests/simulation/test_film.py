"""Films: refusals before the flight, and written files."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.simulation import flight_film as films
from hitchopt.simulation.flight_film import check_film, save_film
from hitchopt.simulation.flight_records import Film


def moving(frames: int) -> Film:
    """Return the film of two cables that rise."""
    nodes = np.zeros((frames, 7, 3), dtype=np.float32)
    nodes[..., 0] = np.arange(7)
    nodes[..., 1] = np.arange(7) % 2
    nodes[..., 2] = np.arange(frames)[:, None]
    return Film(0.04 * np.arange(frames, dtype=np.float64), nodes, np.array([0, 3, 7]))


def test_a_film_shows_the_flight_in_real_time(tmp_path: Path) -> None:
    path = tmp_path / "flight.gif"
    save_film(path, moving(9))
    pictures = imageio.imread(path)
    assert pictures.shape == (5, 480, 640, 3)  # every other one of nine, at 12.5 Hz
    assert imageio.immeta(path)["duration"] == pytest.approx(80, abs=10)
    assert len({picture.tobytes() for picture in pictures}) == 5
    assert [entry.name for entry in tmp_path.iterdir()] == ["flight.gif"]


def test_an_mp4_without_ffmpeg_is_refused_before_the_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(films, "find_spec", lambda name: name == "imageio" or None)
    check_film(Path("flight.gif"))
    with pytest.raises(UnsupportedError, match=r"flight\.MP4: an mp4 needs ffmpeg"):
        check_film(Path("flight.MP4"))
    monkeypatch.setattr(films, "find_spec", lambda _: None)
    with pytest.raises(UnsupportedError, match="films need imageio"):
        check_film(Path("flight.gif"))


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        save_film(tmp_path / "missing" / "flight.gif", moving(3))
    with pytest.raises(FileError, match="before there was anything to film"):
        save_film(tmp_path / "flight.gif", moving(1))
    assert list(tmp_path.iterdir()) == []
