"""The commands ``report`` and ``view``: a plan to look at."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hitchopt.cli.commands import main, report_suggestions
from hitchopt.cli.failures import UNMET, complain
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError

if TYPE_CHECKING:
    from hitchopt.checks import Certificate
    from hitchopt.mission.loading import AnyProblem
    from hitchopt.mission.repair.change import Suggestion
    from hitchopt.plan import Plan
    from hitchopt.view.editing_session import Status
    from hitchopt.view.live_view import LiveView

PROBLEM = "problem.yaml"
"""Name under which an edited problem is saved beside its plan."""

PROBLEM_ENDINGS = (".yaml", ".yml")
"""Endings of the names of problem files."""

PATIENCE = 3.0
"""Time for which the processor is left to the browser, until it has loaded the page [s]."""

DRAWING = 1.5
"""Time for which it is left to it after that, to draw the first picture [s]: graphics cards are
not everywhere."""

SEARCH = 60.0
"""Time limit of the search for changes that make a problem feasible [s]."""


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
def report(directory: Path) -> None:
    """Write DIR/report.html: the plan in one file that needs no network.

    It plays the plan in three dimensions, with plots of separation, speed, thrust and tension, the
    certificate, the phases, the problem file, versions and digests.
    """
    from hitchopt.cli.progress import LateProgress
    from hitchopt.plan import load

    place = plan_path(directory).parent
    with LateProgress(sys.stderr, "certifying and writing"):
        path = load(place).report(place)
    record(file=str(path))
    say(f"open {path} in a browser")


@main.command()
@click.argument("path", metavar="DIR|FILE", type=GivenPath())
@click.option(
    "--save", metavar="FILE", type=GivenPath(), help="Write a page, picture or film; do not serve."
)
@click.option(
    "--ghost",
    metavar="PATH",
    type=GivenPath(),
    help="Show another plan, or a simulated flight, at its side: its directory or file.",
)
@click.option("--host", default="127.0.0.1", help="Address to listen on; by default this machine.")
@click.option("--port", default=8080, help="Port to listen on, or the next free one.")
@click.option("--browser/--no-browser", default=True, help="Whether to open the browser.")
def view(
    path: Path, save: Path | None, ghost: Path | None, host: str, port: int, browser: bool
) -> None:
    """Show the plan in DIR in the browser, live, and edit it by hand; Ctrl-C ends it (needs viser).

    Of a problem FILE (.yaml) the plan is made first; if it cannot be met, that of the smallest
    change that makes it feasible is shown, and changes are offered. Vertices, edges and the hitch
    can be dragged; the plan is made again in the background, and Save writes the problem file:
    FILE, or DIR/problem.yaml.

    With --save FILE nothing is served: .html is the report; .png, .svg and .pdf are the
    summary; .mp4 and .gif are a film in real time, 1280 × 720 (needs imageio).

    Of a simulated flight, DIR/simulation, the film is saved, and live it is the ghost of its plan.
    """
    flight = _flight(path)
    if flight is not None:
        path = _flown(flight)
        ghost = ghost or flight
    if save is not None:
        if flight is not None and ghost == flight:
            _save_flight(flight, path, save)
            return
        if ghost is not None:
            words = "no ghost where a plan is written to a file"
            raise InputError("--ghost", str(ghost), words, "leave --save out: it is shown live")
        _save(path, save)
        return
    import threading
    import webbrowser

    from hitchopt.view.live_server import open_server, server_address

    plan, status = shown_plan(path) if path.suffix in PROBLEM_ENDINGS else (None, None)
    if plan is None:
        _refuse_damaged(plan_path(path))
    server = open_server(host, port)
    address = server_address(server)
    say(f"the plan is at {address}; Ctrl-C ends this")
    if browser:  # it loads the page while the plan is read; some browsers return late
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    close = server.stop
    try:
        close = _serve(server, path, plan, status, ghost).close
        threading.Event().wait()
    finally:
        close()


def _flight(path: Path) -> Path | None:
    """Return the recording of a simulated flight that is at a path, or None."""
    from hitchopt.storage.archive import PLAN, RECORDING

    file = path / RECORDING if path.is_dir() and not (path / PLAN).exists() else path
    return file if file.name == RECORDING and file.is_file() else None


def _flown(flight: Path) -> Path:
    """Return the directory of the plan of a simulated flight, that above its own."""
    from hitchopt.storage.archive import PLAN

    place = flight.resolve().parent.parent
    if not (place / PLAN).is_file():
        raise FileError(f"{flight}: its plan is not in {place}; keep the two together")
    return place


def _save_flight(flight: Path, place: Path, file: Path) -> None:
    """Write the film of a simulated flight of the plan in a directory."""
    from hitchopt.cli.simulate_command import save_flight_film
    from hitchopt.motion.plan_file import read_plan, read_title
    from hitchopt.view.film import check_film
    from hitchopt.view.ghost_scene import ghost_scene

    check_film(file)
    plan = plan_path(place)
    save_flight_film(file, ghost_scene(flight, read_plan(plan)), read_title(plan))
    record(file=str(file))


def _refuse_damaged(file: Path) -> None:
    """Raise FileError for a file that holds no plan, before a page is opened for it."""
    from hitchopt.storage.archive import BROKEN, read_arrays

    try:
        read_arrays(file, ("settings", "breaks", "drones"))
    except BROKEN:
        from hitchopt.motion.plan_file import read_plan  # slow to import, and says what is wrong

        read_plan(file)


def _serve(
    server: Any, path: Path, plan: Plan | None, status: Status | None, ghost: Path | None
) -> LiveView:
    """Show a plan, or that in a directory, in the page of a server, to be edited there."""
    from hitchopt.view.ghost_scene import ghost_scene
    from hitchopt.view.live_view import ASPECT, NARROW_ASPECT, LiveView

    certificate = None
    if plan is not None:
        motion, certificate, title, text = plan.motion, plan.certificate, plan.title, plan.problem
    else:
        from hitchopt.motion.plan_file import read_plan, read_problem_text, read_title

        file = plan_path(path)
        motion, title, text = read_plan(file), read_title(file), read_problem_text(file)
        path = file.with_name(PROBLEM)
    other = None if ghost is None else ghost_scene(ghost, motion)
    aspect = NARROW_ASPECT if text and motion.team.has_cables else ASPECT
    live = LiveView(motion, certificate, title, ghost=other, server=server, aspect=aspect)
    if certificate is None:
        from hitchopt.checks import certify

        if live.wait_for_page(PATIENCE):
            time.sleep(DRAWING)
        certificate = certify(motion)
        live.show_certificate(certificate)
    _edit(live, text, path, certificate, status)
    return live


def _planned(path: Path) -> Plan:
    """Return the plan of a problem file, with its text."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.planning import solve
    from hitchopt.storage.yaml_file import read_text

    text, _ = read_text(path)
    with LateProgress(sys.stderr, "planning") as progress:
        return replace(solve(path, progress), problem=text)


def shown_plan(path: Path) -> tuple[Plan, Status | None]:
    """Return what is shown of a problem file: its plan, or one with a change, and how they relate.

    Exits where there is no plan, and no change was found.
    """
    try:
        return _planned(path), None
    except InfeasibleError as error:
        problem, found = _suggested(path, error)
        words = str(error)
    if not found:
        say(f"nothing to show: change {path} as the errors say, then view it again", err=True)
        click.get_current_context().exit(UNMET)
    from hitchopt.planning import solve
    from hitchopt.storage.yaml_file import read_text
    from hitchopt.view.editing_session import Stage, Status

    say("the page shows the plan of the first change; a click on a change makes it")
    plan = replace(solve(found[0].change.problem), title=problem.title, problem=read_text(path)[0])
    return plan, Status(Stage.SUGGESTED, words, found)


def _suggested(path: Path, error: InfeasibleError) -> tuple[AnyProblem, tuple[Suggestion, ...]]:
    """Report what binds, and return the problem with the changes that make it feasible."""
    from hitchopt.mission.loading import read_problem
    from hitchopt.mission.problem import Problem

    complain(error)
    problem = read_problem(path)
    if not isinstance(problem, Problem):
        return problem, ()
    return problem, report_suggestions(problem, error, SEARCH)[1]


def _edit(
    live: LiveView, text: str, path: Path, certificate: Certificate, status: Status | None
) -> None:
    """Offer to edit the problem of the plan shown, or say why it cannot be edited."""
    from hitchopt.steps.certified_motions import Certified
    from hitchopt.view.editing_panel import EditingPanel
    from hitchopt.view.editing_session import Editing

    try:
        editing = Editing(text, path, Certified(live.motion, certificate), status=status)
    except HitchoptError as error:
        say(f"it cannot be edited here: {error}")
        return
    EditingPanel(live, editing)


def _save(path: Path, file: Path) -> None:
    """Write the plan as a page or picture, by the name's ending."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.plan import load

    planned = path.suffix in PROBLEM_ENDINGS
    try:
        with LateProgress(sys.stderr, "certifying and drawing") as progress:
            plan = _planned(path) if planned else load(plan_path(path).parent)
            plan.view(file, progress=progress)
    except InfeasibleError as error:
        if _suggested(path, error)[1]:
            say(f"nothing is written; hitchopt view {path} shows the first change", err=True)
        click.get_current_context().exit(UNMET)
    record(file=str(file))
    say(f"wrote {file}")
