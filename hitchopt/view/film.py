"""Films of scenes, in real time: mp4, or gif."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import interp1d
from scipy.ndimage import gaussian_filter1d

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.values import Array
from hitchopt.view.painter import Camera, Painter, draw_painting
from hitchopt.view.scene import Scene
from hitchopt.view.style import drafted, draw_lines, facts

SIZE, DOTS = (12.8, 7.2), 100  # Size of a frame [in], and its resolution [1/in]
# Frames a second [Hz]; a gif counts in hundredths of a second, and is large
RATES = {".mp4": 30.0, ".gif": 100.0 / 6.0}
AZIMUTH, ELEVATION = -115.0, 32.0  # Where a film is seen from [deg]
# Margin around drones and cables [m]; as shares of a frame's height, the part above it for words,
# the least half width of a cable, and the least reach of a drone
MARGIN, HEAD, THIN, SMALL = 0.2, 0.09, 0.0022, 0.012
SMOOTH = 1.5  # Time over which the camera's motion is smoothed, a standard deviation [s]


def save_film(
    path: Path, scene: Scene, title: str = "", progress: Callable[[float], None] | None = None
) -> None:
    """Write the film of a scene, 1280 × 720, with a title above it.

    ``path`` ends in .gif or .mp4, or there is an InputError; ``progress`` is called with the
    fraction that is done. UnsupportedError names a missing package, FileError a file that cannot be
    written.
    """
    kind = path.suffix.lower()
    if kind not in RATES:
        raise InputError("film", str(path), "a name in .gif or .mp4", "such as flight.mp4")
    try:
        import imageio.v2 as imageio

        if kind == ".mp4":
            import imageio_ffmpeg  # noqa: F401
    except ImportError as error:
        words = f"needs {error.name}, which is not installed; pip install 'hitchopt[view]'"
        raise UnsupportedError(f"{path}: {words}") from error
    rate = RATES[kind]
    options: dict[str, Any] = {"fps": rate, "macro_block_size": 8}
    if kind == ".gif":
        options = {"duration": 1000.0 / rate, "loop": 0}
    times = np.arange(int(np.ceil(scene.t[-1] * rate)) + 1) / rate
    with drafted(path) as draft:
        film: Any = imageio.get_writer(draft, **options)
        with film as writer:
            for i, frame in enumerate(frames(scene, times, title)):
                writer.append_data(frame)
                if progress is not None:
                    progress((i + 1) / len(times))


def frames(scene: Scene, times: Array, title: str) -> Iterator[NDArray[np.uint8]]:
    """Yield a frame (720, 1280, 3) for every time [s]; the camera follows what flies."""
    camera = Camera.toward(AZIMUTH, ELEVATION)
    figure: Any = Figure(SIZE, dpi=DOTS)
    canvas: Any = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    flying = [scene.drones, scene.cables.reshape(len(scene.t), -1, 3)]
    seen = camera.seen(np.concatenate(flying, axis=1))[..., :2]
    even = np.linspace(0.0, scene.t[-1], max(2, int(10.0 * scene.t[-1])))
    ends = np.stack([np.min(seen, axis=1), np.max(seen, axis=1)], axis=-1)
    corners = interp1d(scene.t, ends, axis=0)(even)
    middles = gaussian_filter1d(np.mean(corners, axis=-1), SMOOTH / even[1], axis=0, mode="nearest")
    reach = np.max(np.abs(corners - middles[..., None]), axis=(0, 2)) + MARGIN
    height = 2.0 * max(reach[1], reach[0] * SIZE[1] / SIZE[0]) / (1.0 - HEAD)
    width = height * SIZE[0] / SIZE[1]
    draw_lines(axes, camera.seen(_ground(scene))[..., :2], "0.9", 0.7, 1)
    size = max(1.0, SMALL * height / scene.motion.requirements.separation.radius)
    painter = Painter(scene, camera, max(scene.radius, THIN * height), size)
    shapes: Any = draw_painting(axes, painter.painted(scene.at(0.0)))
    words: dict[str, Any] = {"fontsize": 13, "parse_math": False, "zorder": 3}
    figure.text(0.02, 0.945, f"{title}\n{facts(scene.motion)}".strip(), va="center", **words)
    clock = figure.text(0.98, 0.945, "", ha="right", va="center", **words)
    phases = scene.motion.phases
    for time in times:
        x, y = (np.interp(time, even, values) for values in middles.T)
        bottom = y - 0.5 * height * (1.0 - HEAD)
        axes.set(xlim=(x - 0.5 * width, x + 0.5 * width), ylim=(bottom, bottom + height))
        painting = painter.painted(scene.at(float(time)))
        shapes.set_verts(painting.polygons)
        shapes.set_facecolor(painting.colours)
        phase = next((p for p in phases if time < p.end), phases[-1])
        clock.set_text(f"{phase.name}   {min(time, scene.t[-1]):6.2f} s")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _ground(scene: Scene) -> Array:
    """Return the lines (m, 2, 3) [m] of a grid on the ground, well beyond all paths."""
    lower, upper = np.min(scene.drones, axis=(0, 1))[:2], np.max(scene.drones, axis=(0, 1))[:2]
    reach, floor = float(np.max(np.ptp(scene.drones, axis=(0, 1)))), scene.motion.requirements.floor
    step = 10.0 ** np.round(np.log10(max(reach, 1.0) / 6.0))
    near, far = (lower - 3.0 * reach) // step * step, (upper + 3.0 * reach) // step * step + step
    across, up = (np.arange(near[i], far[i] + step / 2, step) for i in range(2))
    lines = [[[x, near[1], floor], [x, far[1], floor]] for x in across]
    return np.array([*lines, *([[near[0], y, floor], [far[0], y, floor]] for y in up)])
