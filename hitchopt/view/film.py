"""Films of scenes, in real time: mp4, or gif."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.view.house_colours import facts
from hitchopt.view.painter import Camera, Painter
from hitchopt.view.scene import Scene, extent_points

SUFFIXES = (".gif", ".mp4")

SIZE, DOTS = (12.8, 7.2), 100
"""Size of a frame [in], and its resolution [1/in]."""

RATES = {".mp4": 30.0, ".gif": 100.0 / 6.0}
"""Frames a second [Hz]; a gif counts in hundredths of a second, and is large."""

AZIMUTH, ELEVATION = -115.0, 32.0
"""Where a film is seen from [deg]."""

MARGIN, HEAD = 0.3, 0.09
"""Margin around everything [m], and the part of a frame above it for words."""

THIN, SMALL = 0.0022, 0.012
"""Least half width of a cable and least reach of a drone, as shares of the frame's height."""


def save_film(
    path: Path, scene: Scene, title: str = "", progress: Callable[[float], None] | None = None
) -> None:
    """Write the film of a scene, 1280 × 720.

    Parameters
    ----------
    path: ends in .gif or .mp4.
    scene: a plan, or a simulated flight.
    title: words above it.
    progress: called with the fraction that is done.

    Raises
    ------
    InputError: another ending.
    UnsupportedError: a required package is not installed.
    FileError: the file cannot be written.
    """
    check_film(path)
    import imageio.v2 as imageio

    kind = path.suffix.lower()
    rate = RATES[kind]
    options: dict[str, Any] = {"fps": rate, "macro_block_size": 8} if kind == ".mp4" else {}
    if kind == ".gif":
        options = {"duration": 1000.0 / rate, "loop": 0}
    times = np.arange(int(np.ceil(scene.t[-1] * rate)) + 1) / rate
    draft = path.with_name(f".{path.stem}.part{kind}")
    try:
        made: Any = imageio.get_writer(draft, **options)
        with made as writer:
            for i, frame in enumerate(frames(scene, times, title)):
                writer.append_data(frame)
                if progress is not None:
                    progress((i + 1) / len(times))
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
        raise InputError("film", str(path), "a name in .gif or .mp4", "such as flight.mp4")
    needed = ("imageio", "imageio_ffmpeg") if path.suffix.lower() == ".mp4" else ("imageio",)
    for name in needed:
        if find_spec(name) is None:
            words = f"{path}: needs {name}, which is not installed; pip install 'hitchopt[view]'"
            raise UnsupportedError(words)


def frames(scene: Scene, times: NDArray[np.float64], title: str) -> Iterator[NDArray[np.uint8]]:
    """Yield a frame (720, 1280, 3) for every time [s]."""
    camera = Camera.toward(AZIMUTH, ELEVATION)
    figure: Any = Figure(SIZE, dpi=DOTS)
    canvas: Any = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    seen = camera.seen(extent_points(scene))[..., :2]
    lower, upper = np.min(seen, axis=(0, 1)) - MARGIN, np.max(seen, axis=(0, 1)) + MARGIN
    height = max(upper[1] - lower[1], (upper[0] - lower[0]) * SIZE[1] / SIZE[0]) / (1.0 - HEAD)
    width = height * SIZE[0] / SIZE[1]
    middle = 0.5 * (lower[0] + upper[0])
    bottom = 0.5 * (lower[1] + upper[1]) - 0.5 * height * (1.0 - HEAD)
    axes.set_xlim(middle - 0.5 * width, middle + 0.5 * width)
    axes.set_ylim(bottom, bottom + height)
    axes.add_collection(_ground(scene, camera))
    reach = scene.motion.requirements.separation.radius
    size = max(1.0, SMALL * height / reach)
    painter = Painter(scene, camera, max(scene.radius, THIN * height), size)
    # Edges of the faces' colour close the seams between them.
    shapes: Any = PolyCollection([], linewidths=0.3, edgecolors="face", zorder=2)
    axes.add_collection(shapes)
    words: dict[str, Any] = {"fontsize": 13, "parse_math": False, "zorder": 3}
    figure.text(0.02, 0.945, f"{title}\n{facts(scene.motion)}".strip(), va="center", **words)
    clock = figure.text(0.98, 0.945, "", ha="right", va="center", **words)
    phases = scene.motion.phases
    for time in times:
        painting = painter.painted(scene.at(float(time)))
        shapes.set_verts(painting.polygons)
        shapes.set_facecolor(painting.colours)
        phase = next((p for p in phases if time < p.end), phases[-1])
        clock.set_text(f"{phase.name}   {min(time, scene.t[-1]):6.2f} s")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _ground(scene: Scene, camera: Camera) -> LineCollection:
    """Return a grid of lines on the ground, well beyond all paths."""
    lower, upper = np.min(scene.drones, axis=(0, 1)), np.max(scene.drones, axis=(0, 1))
    extent = float(np.max(upper - lower))
    step = 10.0 ** np.round(np.log10(max(extent, 1.0) / 6.0))
    ends = [np.floor((lower[:2] - 3 * extent) / step), np.ceil((upper[:2] + 3 * extent) / step)]
    lines = []
    for axis in (0, 1):
        along = step * np.arange(ends[0][axis], ends[1][axis] + 1)
        line = np.full((len(along), 2, 3), scene.motion.requirements.floor)
        line[:, :, axis] = along[:, None]
        line[:, :, 1 - axis] = step * np.array([ends[0][1 - axis], ends[1][1 - axis]])
        lines.append(line)
    seen = camera.seen(np.concatenate(lines))[..., :2]
    return LineCollection(list(seen), colors="0.9", linewidths=0.7, zorder=1)
