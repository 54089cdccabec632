"""Films of scenes, in real time: mp4, or gif."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from scipy.interpolate import interp1d
from scipy.ndimage import gaussian_filter1d

from hitchopt.errors import InputError, optional_module
from hitchopt.values import Array
from hitchopt.view.painter import Camera, Painter, draw_ground, draw_painting
from hitchopt.view.scene import Scene
from hitchopt.view.style import atomic_write, facts, own_style

FRAME_SIZE = (12.8, 7.2)  # Size of a frame [inch]
RESOLUTIONS = {".mp4": 100, ".gif": 50}  # Resolutions of frames [1/inch]
# Largest frame rates [Hz]; the resolution of a gif's clock is 10 ms
RATES = {".mp4": 30.0, ".gif": 100.0 / 6.0}
MAX_GIF_FRAMES = 240  # Largest number of a gif's frames, of some 20 kB each
TEXT_SIZE = 16.0  # Size of titles [points], at least MIN_TEXT_SIZE [pixels]
MIN_TEXT_SIZE = 13.0
HEADER_COLOUR = (1.0, 1.0, 1.0, 0.85)  # Colour behind titles
AZIMUTH = -115.0  # Azimuth of the camera [deg]
ELEVATION = 32.0  # Elevation of the camera [deg]
MARGIN = 0.2  # Margin around drones and cables [m]
HEADER_SHARE = 0.09  # Height of the header above the scene, as a fraction of the frame's
MIN_CABLE_WIDTH = 0.0022  # Minimum half width of a cable, as a fraction of the frame's height
MIN_DRONE_SIZE = 0.012  # Minimum radius of a drone, as a fraction of the frame's height
SMOOTHING_TIME = 1.5  # Standard deviation of the smoothing of the camera's motion [s]


@own_style()
def save_film(
    path: Path, scene: Scene, title: str = "", progress: Callable[[float], None] | None = None
) -> None:
    """Write the film of a scene, 1280 × 720, with a title above it.

    A gif has 640 × 360 pixels and at most MAX_GIF_FRAMES frames, to remain below 5 MB. ``progress``
    is called with the completed fraction. Raises InputError unless ``path`` ends in .gif or .mp4,
    UnsupportedError for a missing package, and FileError if the file cannot be written.
    """
    kind = path.suffix.lower()
    if kind not in RATES:
        raise InputError(
            "film", str(path), "a name that ends in .gif or .mp4", "such as flight.mp4"
        )
    imageio = optional_module("imageio.v2", f"{path}: needs", "view")
    if kind == ".mp4":
        optional_module("imageio_ffmpeg", f"{path}: needs", "view")
    rate = RATES[kind]
    if kind == ".gif":
        # Of its clock, per frame
        steps = np.ceil(100.0 * float(scene.t[-1]) / (MAX_GIF_FRAMES - 2))
        rate = 100.0 / max(6.0, float(steps))
    options: dict[str, Any] = {"fps": rate, "macro_block_size": 8}
    if kind == ".gif":
        options = {"duration": 1000.0 / rate, "loop": 0}
    times = np.arange(int(np.ceil(scene.t[-1] * rate)) + 1) / rate
    with atomic_write(path) as draft:
        film: Any = imageio.get_writer(draft, **options)
        with film as writer:
            for i, frame in enumerate(frames(scene, times, title, RESOLUTIONS[kind])):
                writer.append_data(frame)
                if progress is not None:
                    progress((i + 1) / len(times))


def frames(scene: Scene, times: Array, title: str, resolution: int) -> Iterator[NDArray[np.uint8]]:
    """Yield a frame for each time [s], (720, 1280, 3) at a resolution of 100 dots per inch.

    The camera follows drones and cables.
    """
    camera = Camera.at_angles(AZIMUTH, ELEVATION)
    figure: Any = Figure(FRAME_SIZE, dpi=resolution)
    canvas: Any = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    view = _View.following(scene, camera)
    draw_ground(axes, scene, camera)
    size = max(1.0, MIN_DRONE_SIZE * view.height / scene.flight.requirements.separation.radius)
    painter = Painter(scene, camera, max(scene.radius, MIN_CABLE_WIDTH * view.height), size)
    shapes: Any = draw_painting(axes, painter.paint(scene.at(0.0)))
    words: dict[str, Any] = {
        "fontsize": max(TEXT_SIZE, 72.0 * MIN_TEXT_SIZE / resolution),
        "parse_math": False,
        "zorder": 3,
    }
    header = Rectangle(
        (0.0, 1.0 - HEADER_SHARE), 1.0, HEADER_SHARE, color=HEADER_COLOUR, zorder=2.5
    )
    figure.add_artist(header)
    figure.text(0.02, 0.955, f"{title}\n{facts(scene.flight)}".strip(), va="center", **words)
    clock = figure.text(0.98, 0.955, "", ha="right", va="center", **words)
    phases = scene.flight.phases
    for time in times:
        left, bottom = view.corner(time)
        axes.set(xlim=(left, left + view.width), ylim=(bottom, bottom + view.height))
        painting = painter.paint(scene.at(float(time)))
        shapes.set_verts(painting.polygons)
        shapes.set_facecolor(painting.colours)
        phase = next((p for p in phases if time < p.end), phases[-1])
        clock.set_text(f"{phase.name}   {min(time, scene.t[-1]):6.2f} s")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


class _View(NamedTuple):
    """A frame's view of constant size, which follows drones and cables smoothly."""

    width: float  # [m]
    height: float  # [m], including the header
    times: Array  # (m,) [s]
    middles: Array  # (m, 2) [m], centres of the scene below the header

    @classmethod
    def following(cls, scene: Scene, camera: Camera) -> _View:
        """Return the view in which all drones and cables are visible at all times."""
        points = [scene.drones, scene.cables.reshape(len(scene.t), -1, 3)]
        projected = camera.project(np.concatenate(points, axis=1))[..., :2]
        corners = np.stack([np.min(projected, axis=1), np.max(projected, axis=1)], axis=-1)
        times = np.linspace(0.0, scene.t[-1], max(2, int(10.0 * scene.t[-1])))
        recorded = np.maximum(times, scene.t[0])  # a flight's first sample is later than its start
        corners = interp1d(scene.t, corners, axis=0)(recorded)
        deviation = SMOOTHING_TIME / times[1]  # in samples
        middles = gaussian_filter1d(np.mean(corners, axis=-1), deviation, axis=0, mode="nearest")
        reach = np.max(np.abs(corners - middles[..., None]), axis=(0, 2)) + MARGIN
        half_height = max(reach[1], reach[0] * FRAME_SIZE[1] / FRAME_SIZE[0])
        height = 2.0 * half_height / (1.0 - HEADER_SHARE)
        return cls(height * FRAME_SIZE[0] / FRAME_SIZE[1], height, times, middles)

    def corner(self, time: float) -> tuple[float, float]:
        """Return the lower left corner [m] at a time [s]."""
        x, y = (float(np.interp(time, self.times, values)) for values in self.middles.T)
        return x - 0.5 * self.width, y - 0.5 * self.height * (1.0 - HEADER_SHARE)
