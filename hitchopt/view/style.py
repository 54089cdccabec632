"""Line styles and legends that all pictures share, and how a picture is written."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

INK = "0.1"
LIMIT_COLOUR = "#b3261e"

DASHES = (0, (6, 2))
"""Line style of limits: they differ from curves in grey as well."""

RESOLUTION = 120
"""Resolution of every picture [dots per inch]."""


def new_figure(size: tuple[float, float]) -> Figure:
    """Return an empty figure of a size [inch], drawn without pyplot."""
    figure = Figure(figsize=size, dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


UNDATED: dict[str, dict[str, str | None]] = {
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
"""Kinds of drawings, and what would make their bytes depend on more than their content."""

COMPRESSION = 1
"""Level of zlib: PNG files are 5 to 12 % larger than with 6, in half to two thirds of the time."""


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write a figure as SVG or PDF if its name ends so, else as PNG.

    Its bytes depend on its content only.

    Raises
    ------
    OSError: the file cannot be written.
    """
    with warnings.catch_warnings():
        # A title in a script that the font lacks is drawn with boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        kind = Path(path).suffix[1:].lower()
        layout = figure.get_layout_engine()
        if layout is not None:  # savefig would draw all of it once more for that
            layout.execute(figure)
            figure.set_layout_engine(None)
        try:
            if kind in UNDATED:
                with rc_context({"svg.hashsalt": "hitchopt"}):
                    figure.savefig(path, format=kind, dpi=RESOLUTION, metadata=UNDATED[kind])
            else:
                _save_png(figure, path)
        finally:
            figure.set_layout_engine(layout)


def _save_png(figure: Figure, path: Path | str) -> None:
    """Write a figure as PNG without a channel of opacity, which takes a quarter of the time."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    size = (round(figure.bbox.width), round(figure.bbox.height))
    drawn = canvas.buffer_rgba()  # type: ignore[no-untyped-call]
    opaque = Image.frombuffer("RGBA", size, drawn).convert("RGB")
    dots = (RESOLUTION, RESOLUTION)
    opaque.save(path, format="png", compress_level=COMPRESSION, dpi=dots)


def marker(shape: str, fill: str, edge: str, label: str, size: float = 6.0) -> Line2D:
    """Return a single marker of a size [points], such as a legend shows."""
    return Line2D(
        [], [], linestyle="none", marker=shape, markersize=size, markerfacecolor=fill,
        markeredgecolor=edge, label=label,
    )  # fmt: skip


def legend_below(axes: Axes, handles: Sequence[Artist], gap: float, columns: int) -> None:
    """Draw a legend below the axes, ``gap`` of their height away."""
    axes.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, -gap), ncols=columns,
        frameon=False, fontsize="small",
    )  # fmt: skip
