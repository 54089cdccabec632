"""Film of a simulated flight: drones and cables in space."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.simulation.flight_records import Film

Array = NDArray[np.float64]

SUFFIXES = (".gif", ".mp4")

ENCODERS = ("imageio_ffmpeg", "av")
"""Modules with which imageio writes mp4."""

SIZE, DOTS = (6.4, 4.8), 100
"""Size of a frame [in], and its resolution [1/in]."""

MARGIN = 0.15
"""Margin around everything that moves [m]."""


def save_film(path: Path, film: Film, rate: float = 12.5) -> None:
    """Write the film of a flight, in real time: a gif, or an mp4 where ffmpeg is installed.

    Parameters
    ----------
    path: ends in .gif or .mp4.
    film: shapes of the cables.
    rate: largest number of frames per second [Hz].

    Raises
    ------
    InputError: another ending.
    UnsupportedError: a required package is not installed.
    FileError: the file cannot be written, or the film has less than two frames.
    """
    check_film(path)
    import imageio.v3 as imageio

    if len(film.t) < 2:
        raise FileError(f"{path}: the flight ended before there was anything to film")
    period = float(np.median(np.diff(film.t)))
    step = max(1, round(1.0 / rate / period))
    frames, shown = _frames(film, step), period * step
    draft = path.with_name(f".{path.stem}.part{path.suffix.lower()}")
    try:
        if path.suffix.lower() == ".gif":
            imageio.imwrite(draft, frames, duration=1000.0 * shown, loop=0)
        else:
            imageio.imwrite(draft, frames, fps=1.0 / shown)
        draft.replace(path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error}; name another place") from error
    finally:
        draft.unlink(missing_ok=True)


def check_film(path: Path) -> None:
    """Check that a film can be written under a name.

    Raises
    ------
    InputError: another ending than .gif or .mp4.
    UnsupportedError: a required package is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError("--film", str(path), "a name in .gif or .mp4", "such as flight.gif")
    if find_spec("imageio") is None:
        raise UnsupportedError(
            "films need imageio, which is not installed; pip install 'hitchopt[simulate]'"
        )
    if path.suffix.lower() == ".mp4" and not any(find_spec(name) for name in ENCODERS):
        raise UnsupportedError(
            f"{path}: an mp4 needs ffmpeg; pip install 'imageio[ffmpeg]', or name a .gif"
        )


def _frames(film: Film, step: int) -> NDArray[np.uint8]:
    """Return every step-th frame (frames, height, width, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(SIZE, dpi=DOTS)
    canvas: Any = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.0, 0.93, 1.0), projection="3d")
    lower, upper = np.min(film.nodes, axis=(0, 1)), np.max(film.nodes, axis=(0, 1))
    for axis, low, high in zip("xyz", lower - MARGIN, upper + MARGIN, strict=True):
        getattr(axes, f"set_{axis}lim")(low, high)
        getattr(axes, f"set_{axis}label")(f"{axis} [m]")
    axes.set_box_aspect(upper - lower + 2.0 * MARGIN)
    axes.view_init(elev=35.0, azim=-60.0)
    ends = np.column_stack([film.cables[:-1], film.cables[1:] - 1]).ravel()
    lines = [axes.plot([], [], [], lw=1.6)[0] for _ in film.cables[1:]]
    drones = axes.plot([], [], [], "o", color="black", ms=6)[0]
    title = axes.text2D(0.02, 0.95, "", transform=axes.transAxes)
    frames = []
    for i in range(0, len(film.t), step):
        nodes = film.nodes[i]
        for line, cable in zip(lines, np.split(nodes, film.cables[1:-1]), strict=True):
            line.set_data_3d(*cable.T)
        drones.set_data_3d(*nodes[ends].T)
        title.set_text(f"t = {film.t[i]:.1f} s")
        canvas.draw()
        frames.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    return np.array(frames)
