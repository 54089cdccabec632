"""Colours and words that all pictures and scenes share; new figures, and files of them.

Live views need the colours alone: matplotlib is imported by the functions that draw with it.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

import numpy as np

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, InputError
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

# Colours of cables and drones. The first three differ in grey as well (luminance 20, 45 and 70
# per cent); the last one, of 45 per cent, stands only between the first and the third
COLOURS = ("#0b3c5d", "#2a8c82", "#e0a526", "#c8414f")
# Colours of objects that never move, of those that can be carried, and of keep-outs
TABLE_COLOUR, OBJECT_COLOUR, KEEP_OUT_COLOUR = "#d3d8dd", "#e8d3a8", "#b3261e"
OTHERS = "#969ca2"  # Colour of somebody else's drones and cables
# Colours of drones' frames, and of hollow rotors and of cables' edges
FRAME, OPEN = "#2b2f33", "#ffffff"
MARK_COLOUR = "#e8590c"  # Colour of drones, cables and vertices that a check names
# Colours of curves and of limits, which are dashed and differ from curves in grey as well
INK, LIMIT_COLOUR, DASHES = "0.1", "#b3261e", (0, (6, 2))
# Kinds of drawings, and their metadata that would change with the date
UNDATED: dict[str, dict[str, str | None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
# Resolution of every picture [dots per inch], and level of zlib: files are 5 to 12 % larger than
# with 6, in half to two thirds of the time
RESOLUTION, COMPRESSION = 120, 1
LONG = 98  # Most characters of a line above a figure: phases' names stand on the right


def cable_colours(n: int) -> tuple[str, ...]:
    """Return a colour for each of n cables that differs from both neighbours'.

    The last has one of its own where it can: it is who waits to replace another one.
    """
    index = [k % 3 for k in range(n)]
    if n % 3 and n > 3:
        index[-1] = 3
    return tuple(COLOURS[i] for i in index)


def drone_colours(team: Team) -> tuple[str, ...]:
    """Return a colour for each drone: that of its cable, if there are any."""
    if team.has_cables:
        return tuple(colour for colour in cable_colours(team.robots) for _ in range(2))
    return tuple(COLOURS[i % len(COLOURS)] for i in range(len(team.drone_names)))


def group_colours(motion: Motion) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the colours of the drones and cables of each group that flies.

    Each of several groups has one colour; somebody else's are grey.
    """
    own = [each.motion.team for each in motion.groups]
    looks = [(drone_colours(team), cable_colours(team.robots)) for team in own]
    if len(own) > 1:
        one = [COLOURS[i % len(COLOURS)] for i in range(len(own))]
        looks = [_all_of(team, colour) for team, colour in zip(own, one, strict=True)]
    return looks + [_all_of(each.motion.team, OTHERS) for each in motion.others]


def _all_of(team: Team, colour: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return (colour,) * team.drones, (colour,) * team.robots


def rgb(colours: Iterable[str], *, linear: bool = False) -> Array:
    """Return colours such as #0b3c5d as red, green and blue (…, 3) from 0 to 1.

    They are encoded as in sRGB, or ``linear`` in the intensity of light.
    """
    codes = [list(bytes.fromhex(colour[1:])) for colour in colours]
    encoded = np.array(codes, np.float64).reshape(-1, 3) / 255.0
    if not linear:
        return encoded
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def facts(motion: Motion) -> str:
    """Return who flies for how long."""
    each = []
    for group in motion.groups:
        team, name = group.motion.team, f"{group.name}: " if group.name else ""
        robots = f"{team.robots} robots, " if team.has_cables else ""
        each.append(f"{name}{robots}{team.drones} drones")
    if motion.others:
        each.append(f"beside {', '.join(group.name for group in motion.others)}")
    return f"{'; '.join(each)}, {motion.duration:.4g} s"


def verdict(certificate: Certificate) -> str:
    """Return in words whether a plan is certified."""
    total = sum(check.limit is not None for check in certificate.checks)
    if certificate.certified:
        return f"certified for all t: {total} of {total} limits hold"
    return "NOT CERTIFIED: " + ", ".join(check.name for check in certificate.violated)


def new_figure(
    size: tuple[float, float], layout: Literal["constrained"] | None = "constrained"
) -> Figure:
    """Return an empty figure of a size [inch] and a layout of matplotlib's, without pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=RESOLUTION, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def headline(figure: Figure, title: str, words: str) -> None:
    """Write a plan's title, and words below it, above a figure's left part."""
    name, words = textwrap.shorten(title, LONG, placeholder=" …"), textwrap.fill(words, LONG)
    look: Any = {"x": 0.012, "ha": "left", "fontsize": "large", "parse_math": False}
    figure.suptitle(f"{name}\n{words}".strip(), **look)


def save_figure(figure: Figure, file: Path | str | IO[bytes], dpi: int = RESOLUTION) -> None:
    """Write a figure as PNG, or as SVG or PDF if the file's name ends so; refuse another ending.

    Its bytes depend on its content only. A file that cannot be written is an OSError.
    """
    from matplotlib import rc_context

    kind = Path(file).suffix[1:].lower() if isinstance(file, Path | str) else ""
    options: dict[str, Any] = {"format": "png", "pil_kwargs": {"compress_level": COMPRESSION}}
    if kind not in ("", "png", *UNDATED):
        raise InputError("picture", str(file), "a name in .png, .svg or .pdf", "such as plan.png")
    if kind in UNDATED:
        options = {"format": kind, "metadata": UNDATED[kind]}
    with warnings.catch_warnings(), rc_context({"svg.hashsalt": "hitchopt"}):
        # A title in a script that the font lacks is drawn with boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(file, dpi=dpi, **options)


@contextmanager
def drafted(path: Path) -> Iterator[Path]:
    """Give a hidden file beside ``path`` to write, which takes its place at the end.

    If it cannot be written, nothing is left of it, and a FileError says why.
    """
    draft = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield draft
        draft.replace(path)
    except OSError as error:
        reason = error.strerror or error
        raise FileError(f"{path}: cannot be written: {reason}; name another place") from error
    finally:
        draft.unlink(missing_ok=True)


def marker(shape: str, fill: str, edge: str, label: str, size: float = 6.0) -> Line2D:
    """Return a single marker of a size [points], such as a legend shows."""
    from matplotlib.lines import Line2D

    look: Any = {"markersize": size, "markerfacecolor": fill, "markeredgecolor": edge}
    return Line2D([], [], linestyle="none", marker=shape, label=label, **look)


def draw_lines(
    axes: Axes, lines: Array, colours: Any, width: float, order: int, **more: Any
) -> None:
    """Draw lines (m, points, 2) of a width [points] in one layer."""
    from matplotlib.collections import LineCollection

    shades = colours if isinstance(colours, str) else list(colours)  # two are not colour and alpha
    style = {"colors": shades, "linewidths": width, "zorder": order, **more}
    axes.add_collection(LineCollection(list(np.asarray(lines)), **style), autolim=False)


def from_zero(axes: Axes, headroom: float = 0.1) -> None:
    """Show values from zero to the largest that is drawn, and a share of it beyond."""
    axes.set_ylim(0.0, (1.0 + headroom) * (axes.dataLim.y1 if axes.dataLim.y1 > 0.0 else 1.0))
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def legend_below(axes: Axes, handles: Sequence[Artist], gap: float, columns: int) -> None:
    """Draw a legend below the axes, ``gap`` of their height away."""
    place: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -gap), "ncols": columns}
    axes.legend(handles=handles, frameon=False, fontsize="small", **place)


def write(axes: Axes, text: str, place: Any, offset: Any, **more: Any) -> None:
    """Write a small text at an offset [points] from a place of the axes."""
    look = {"textcoords": "offset points", "ha": "center", "fontsize": "small", **more}
    axes.annotate(text, place, offset, **look)
