"""What plans show of themselves: cards, pictures, reports, and the live view."""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib import axes as mpl_axes

from hitchopt.checks import Certificate
from hitchopt.checks.separation import Closeness
from hitchopt.errors import FileError, InputError, Progress
from hitchopt.motion.flight import Flight
from hitchopt.plan import Plan
from hitchopt.values import path
from hitchopt.view.pictures import (
    Page,
    draw_closeness,
    draw_summary,
    plan_card,
    plot_from_above,
)
from hitchopt.view.report import save_view, write_report
from hitchopt.view.scene import ghost_scene
from hitchopt.view.style import save_figure

if TYPE_CHECKING:
    from hitchopt.view.live import LiveView


def card(plan: Plan) -> str:
    """Return the card for notebooks: picture, phases, certificate and notes."""
    return plan_card(plan.flight, plan.certificate, plan.title, plan.notes)


def plot(plan: Plan, axes: mpl_axes.Axes | None) -> mpl_axes.Axes:
    """Draw a plan from above on axes, or on those of a new figure, and return them."""
    if axes is not None and not isinstance(axes, mpl_axes.Axes):
        raise InputError("axes", axes, "matplotlib axes", "omit it for a new figure")
    return plot_from_above(plan.flight, axes)


def draw(plan: Plan, file: Path) -> None:
    """Draw the summary of a plan to a file."""
    save_figure(draw_summary(plan.flight, plan.certificate, plan.title), file)


def report(
    file: Path,
    flight: Flight,
    certificate: Certificate,
    title: str,
    problem: str,
    directory: Path,
    ghost: Path | str | None,
) -> None:
    """Write the report of a plan, with the digests of its files in a directory."""
    other = None if ghost is None else ghost_scene(path("ghost", ghost), flight)
    write_report(file, flight, certificate, title, problem, directory, other)


def view(
    plan: Plan,
    save: Path | str | None,
    *,
    ghost: Path | str | None,
    figure: tuple[float | None, float | None, Sequence[str] | None],
    address: tuple[str, int],
    browser: bool,
    progress: Progress | None,
) -> LiveView | None:
    """Show a plan live, or write it to a file; see ``Plan.view``.

    ``figure`` has the width, the height and the panels of a saved picture.
    """
    if save is not None:
        if ghost is not None:
            bound = "None when a plan is written to a file"
            raise InputError("ghost", str(ghost), bound, "omit save: ghosts are shown live")
        content = plan.flight, plan.certificate, plan.title, plan.problem
        save_view(path("save", save), *content, progress, Page.of(*figure))
        return None
    from hitchopt.view.live import LiveView, open_server  # an extra

    other = None if ghost is None else ghost_scene(path("ghost", ghost), plan.flight)
    server = open_server(*address)
    live = LiveView(server, plan.flight, plan.certificate, plan.title, ghost=other)
    if browser:
        webbrowser.open(live.url)
    return live


def closeness_picture(
    flight: Flight, pairs: Closeness, width: float | None, file: Path | str
) -> None:
    """Draw the closest pairs of drones over time to a file; raises FileError without access."""
    picture = path("picture", file)
    try:
        save_figure(draw_closeness(flight, pairs, width), picture)
    except OSError as error:
        raise FileError(f"{picture}: cannot be written: {error.strerror}") from error
