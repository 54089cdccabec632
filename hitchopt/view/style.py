"""Colours and labels shared by pictures and scenes; new figures and their files.

Live views only need the colours: functions that draw import matplotlib.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

import numpy as np

from hitchopt.checks.certificate import SAMPLED, Certificate, stated_rule
from hitchopt.errors import FileError, InputError
from hitchopt.hitch import Team
from hitchopt.motion.flight import Flight
from hitchopt.values import Array, counted

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

# Colours of cables and drones: eight that stay apart also without red or green cones, and each of
# which differs from the next in grey
COLOURS = (
    "#0b3c5d", "#2a8c82", "#e0a526", "#c8414f", "#6fb7e9", "#7b4fb5", "#e48fb5", "#7d4e24",
)  # fmt: skip
TABLE_COLOUR = "#d3d8dd"  # Colour of fixed objects
OBJECT_COLOUR = "#e8d3a8"  # Colour of carried objects
KEEP_OUT_COLOUR = "#b3261e"  # Colour of keep-outs
OTHERS_COLOUR = "#969ca2"  # Colour of other plans' drones and cables
FRAME_COLOUR = "#2b2f33"  # Colour of drones' frames
HOLLOW_COLOUR = "#ffffff"  # Colour of hollow rotors and of cables' edges
MARK_COLOUR = "#e8590c"  # Colour of highlighted drones, cables and vertices
INK = "0.1"  # Colour of curves
LIMIT_COLOUR = "#b3261e"  # Colour of limits, which also differs in grey
DASHES = (0, (6, 2))  # Dashes of limits
# Metadata by kind of vector drawing, without dates
UNDATED_METADATA: dict[str, dict[str, str | None]] = {
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
RESOLUTION = 120  # Resolution of pictures [dots per inch]
# Level of zlib: files are 5 to 12 % larger than with level 6, in half to two thirds of the time
COMPRESSION = 1
PAGE_TEXT = 8.0  # Size of all text in figures of a given width, for papers [points]
PAGE_RESOLUTION = 300  # Resolution of such figures [dots per inch]
PAGE_WIDTHS = (2.5, 20.0)  # Smallest and largest width of such figures [inch]
USUAL_PERCENTILE = 99.0  # Percentile of usual values; larger ones are short peaks
PEAK_RATIO = 2.0  # Largest drawn value over this percentile
PAGE_SHARE = 0.7  # Height of a single plot over its width in such figures
LETTER_WIDTH = 0.5  # Width of a letter over its size
HANDLE_WIDTH = 26.0  # Width of an entry of a legend without its text [points]
HEADLINE_LENGTH = 98  # Maximum length of a headline: phases' names are on its right
NARROW_HEADLINE = 84  # The same next to phases of several teams, whose names have several lines


def cable_colours(n: int) -> tuple[str, ...]:
    """Return colours for n cables that differ from both neighbours', and up to eight from all."""
    index = [k % len(COLOURS) for k in range(n)]
    if n > 1 and index[-1] == 0:
        index[-1] = len(COLOURS) // 2
    return tuple(COLOURS[i] for i in index)


def drone_colours(team: Team) -> tuple[str, ...]:
    """Return a colour for each drone, that of its cable if it has one."""
    if team.has_cables:
        return tuple(colour for colour in cable_colours(team.robots) for _ in range(2))
    return tuple(COLOURS[i % len(COLOURS)] for i in range(len(team.drone_names)))


def team_colours(flight: Flight) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Return the colours of the drones and cables of each team.

    Several teams have one colour each; other plans are grey.
    """
    own = [each.motion.team for each in flight.teams]
    looks = [(drone_colours(team), cable_colours(team.robots)) for team in own]
    if len(own) > 1:
        looks = [_uniform_colours(x, COLOURS[i % len(COLOURS)]) for i, x in enumerate(own)]
    return looks + [_uniform_colours(each.motion.team, OTHERS_COLOUR) for each in flight.others]


def _uniform_colours(team: Team, colour: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return (colour,) * team.drones, (colour,) * team.robots


def rgb(colours: Iterable[str], *, linear: bool = False) -> Array:
    """Return colours such as #0b3c5d as red, green and blue (…, 3) from 0 to 1.

    They are encoded as sRGB, or ``linear`` in intensity.
    """
    codes = [list(bytes.fromhex(colour[1:])) for colour in colours]
    encoded = np.array(codes, np.float64).reshape(-1, 3) / 255.0
    if not linear:
        return encoded
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def facts(flight: Flight) -> str:
    """Return the teams and the duration of a plan as text."""
    parts = []
    for each in flight.teams:
        team = each.motion.team
        name = f"{each.name}: " if each.name else ""
        robots = f"{counted(team.robots, 'robot')}, " if team.has_cables else ""
        parts.append(f"{name}{robots}{counted(team.drones, 'drone')}")
    if flight.others:
        parts.append(f"next to {', '.join(each.name for each in flight.others)}")
    return f"{'; '.join(parts)}, {flight.duration:.4g} s"


def verdict(certificate: Certificate) -> str:
    """Return the result of a certificate as text, with the worst values of custom rules."""
    if not certificate.certified:
        return "NOT CERTIFIED: " + ", ".join(check.name for check in certificate.violated)
    sampled = [check.name for check in certificate.limited if check.method == SAMPLED]
    total = len(certificate.limited) - len(sampled)
    parts = [f"certified for all t: {total} of {total} limits hold"]
    if sampled:
        parts.append(f"at samples: {', '.join(sampled)}")
    parts += [str(stated_rule(check)) for check in certificate.checks if check.custom]
    if stated := ", ".join(rule.name for rule in certificate.not_recomputed):
        parts.append(f"not recomputed: {stated}")
    return "; ".join(parts)


@contextmanager
def own_style() -> Iterator[None]:
    """Draw in matplotlib's default style, whatever style or matplotlibrc users have.

    A decorator of all functions that create or write figures: dark styles hide black curves, and
    TeX or a font may be missing.
    """
    from matplotlib import style

    with style.context("default"):
        yield


def new_figure(
    size: tuple[float, float],
    layout: Literal["constrained"] | None = "constrained",
    resolution: int = RESOLUTION,
) -> Figure:
    """Return an empty figure of a size [inch] and a resolution [dots per inch], without pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=resolution, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def page_figure(width: float, height: float) -> Figure:
    """Return an empty figure for a page, of a size [inch].

    Raises InputError if the width is not within PAGE_WIDTHS.
    """
    if not PAGE_WIDTHS[0] <= width <= PAGE_WIDTHS[1]:
        bound = "from {:g} to {:g} inches".format(*PAGE_WIDTHS)
        raise InputError("width", width, bound, "a column of two is 3.5 wide, a page 7")
    return new_figure((width, height), resolution=PAGE_RESOLUTION)


def legend_on_page(figure: Figure, handles: Sequence[Artist]) -> None:
    """Draw a legend below a figure for a page, and write all its text in PAGE_TEXT."""
    longest = max(len(str(handle.get_label())) for handle in handles)
    entry = LETTER_WIDTH * PAGE_TEXT * longest + HANDLE_WIDTH
    columns = max(1, int(72.0 * figure.get_size_inches()[0] / entry))
    look: Any = {"loc": "outside lower center", "frameon": False, "handlelength": 1.6}
    figure.legend(handles=handles, ncols=columns, columnspacing=1.0, fontsize=PAGE_TEXT, **look)
    set_page_text(figure)


def set_page_text(figure: Figure) -> None:
    """Write all text of a figure for a page in PAGE_TEXT."""
    from matplotlib.text import Text

    for axes in figure.axes:
        axes.tick_params(labelsize=PAGE_TEXT)
    for text in figure.findobj(Text):
        text.set_fontsize(PAGE_TEXT)


def headline(figure: Figure, title: str, words: str, length: int = HEADLINE_LENGTH) -> None:
    """Write a plan's title, and words below it, above the left part of a figure."""
    name = textwrap.shorten(title, length, placeholder=" …")
    words = textwrap.fill(words, length)
    look: Any = {"x": 0.012, "ha": "left", "fontsize": "large", "parse_math": False}
    figure.suptitle(f"{name}\n{words}".strip(), **look)


@own_style()
def save_figure(figure: Figure, file: Path | str | IO[bytes], dpi: int | None = None) -> None:
    """Write a figure as PNG, SVG or PDF, according to the file name's extension.

    Its bytes depend on its content only; ``dpi`` is the figure's by default. Fonts in PDF are
    TrueType, which publishers take. Raises InputError for another extension, and OSError if the
    file cannot be written.
    """
    from matplotlib import rc_context

    kind = Path(file).suffix[1:].lower() if isinstance(file, Path | str) else ""
    options: dict[str, Any] = {"format": "png", "pil_kwargs": {"compress_level": COMPRESSION}}
    if kind not in ("", "png", *UNDATED_METADATA):
        raise InputError("picture", str(file), "a name in .png, .svg or .pdf", "such as plan.png")
    if kind in UNDATED_METADATA:
        options = {"format": kind, "metadata": UNDATED_METADATA[kind]}
    with warnings.catch_warnings(), rc_context({"svg.hashsalt": "hitchopt", "pdf.fonttype": 42}):
        # Characters that the font lacks are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(file, dpi=dpi or "figure", **options)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Provide the path of a hidden file, which replaces ``path`` at the end.

    If it cannot be written, it is removed, and a FileError gives the reason.
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
    """Return a single marker of a size [points], for legends."""
    from matplotlib.lines import Line2D

    look: Any = {"markersize": size, "markerfacecolor": fill, "markeredgecolor": edge}
    return Line2D([], [], linestyle="none", marker=shape, label=label, **look)


def draw_lines(
    axes: Axes, lines: Array, colours: Any, width: float, order: int, **more: Any
) -> None:
    """Draw lines (m, points, 2) of a width [points] in one layer."""
    from matplotlib.collections import LineCollection

    colours = colours if isinstance(colours, str) else list(colours)  # a pair is colour and alpha
    style = {"colors": colours, "linewidths": width, "zorder": order, **more}
    axes.add_collection(LineCollection(list(np.asarray(lines)), **style), autolim=False)


def from_zero(axes: Axes, headroom: float = 0.1, values: Array | None = None) -> None:
    """Set the vertical axis from zero to the largest drawn value plus a headroom.

    Of drawn ``values`` short peaks are cut, which would flatten all others; the largest is written.
    """
    top = axes.dataLim.y1 if axes.dataLim.y1 > 0.0 else 1.0
    if values is not None and values.size:
        usual = PEAK_RATIO * float(np.percentile(values, USUAL_PERCENTILE))
        if 0.0 < (1.0 + headroom) * usual < top:
            write(
                axes,
                f"up to {top:.3g}",
                (1.0, 1.0),
                (-3, -10),
                xycoords="axes fraction",
                ha="right",
            )
            top = usual
    axes.set_ylim(0.0, (1.0 + headroom) * top)
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def legend_below(axes: Axes, handles: Sequence[Artist], gap: float, columns: int) -> None:
    """Draw a legend below the axes, ``gap`` of their height away."""
    place: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, -gap), "ncols": columns}
    axes.legend(handles=handles, frameon=False, fontsize="small", **place)


def write(axes: Axes, text: str, place: Any, offset: Any, **more: Any) -> None:
    """Write a small text at an offset [points] from a point of the axes."""
    look = {"textcoords": "offset points", "ha": "center", "fontsize": "small", **more}
    axes.annotate(text, place, offset, **look)
