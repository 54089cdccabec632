"""The commands report and view: display plans."""

from __future__ import annotations

import threading
import time
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.options import PATH, SUFFIXES, command, option, plan_path, width_option
from hitchopt.cli.output import ProgressBar, say
from hitchopt.errors import FileError, InputError

if TYPE_CHECKING:
    from hitchopt.motion.plan_file import SavedPlan
    from hitchopt.view.live import LiveView

LOADING_TIME = 3.0  # Maximum time until the browser has loaded the page [s]
# Time to draw the first picture without a graphics card, before the processor is used for
# certification [s]
DRAWING_TIME = 1.5


@command(
    "directory DIR",
    option("--ghost", "Also show another plan, a flight or an evaluation.", PATH, "PATH"),
)
def report(directory: Path, ghost: Path | None) -> None:
    """Write DIR/report.html, a report of the plan in one file that needs no network.

    It has a 3D animation of the plan, plots of separation, speed, thrust and tension, the
    certificate, the phases, the problem file, versions and digests.
    """
    folder = plan_path(directory).parent
    with ProgressBar("certifying and writing"):
        path = ho.load(folder).report(folder, ghost=ghost)
    say(f"open {path} in a browser", file=str(path))


@command(
    "path DIR|FILE",
    option("--save", "Write a page, picture or film instead of serving.", PATH, "FILE"),
    option(
        "--ghost",
        "Show another plan, a simulated flight or an evaluation next to it.",
        PATH,
        "PATH",
    ),
    width_option("a saved picture"),
    option("--height", "Height of that picture; default: that of its parts.", float, "INCHES"),
    option(
        "--panels",
        "Parts of that picture, from plan, separation, speed and thrust; default: all.",
        str,
        "NAME,…",
    ),
    option("--host", "Address to listen on; by default this machine.", "127.0.0.1", "TEXT"),
    option("--port", "Port to listen on, or the next free one.", 8080, "INTEGER"),
    option("--browser/--no-browser", "Open the browser.", True),
)
def view(
    path: Path,
    save: Path | None,
    ghost: Path | None,
    width: float | None,
    height: float | None,
    panels: str | None,
    host: str,
    port: int,
    *,
    browser: bool,
) -> None:
    """Show the plan in DIR live in the browser; Ctrl-C ends it (needs viser).

    A problem FILE (.yaml) is planned first.

    With --save FILE nothing is served: .html is the report; .png, .svg and .pdf are the summary;
    .mp4 and .gif are a film (needs imageio). A simulated flight, DIR/simulation, is saved as a film
    or shown live with its plan.
    """
    from hitchopt.storage.archive import PLAN, RECORDING

    recording = path / RECORDING if path.is_dir() and not (path / PLAN).exists() else path
    is_flight = recording.name == RECORDING and recording.is_file()
    if is_flight:
        path = recording.resolve().parent.parent
        if not (path / PLAN).is_file():
            remedy = f"keep the two together, or show the plan with --ghost {recording}"
            raise FileError(f"{recording}: its plan is not in {path}; {remedy}")
    if save is not None:
        if ghost is not None:
            bound = "omitted when a plan is written to a file"
            raise InputError("ghost", str(ghost), bound, "omit --save: ghosts are shown live")
        names = None if panels is None else [name.strip() for name in panels.split(",")]
        _save(save, path, recording if is_flight else None, (width, height, names))
        return
    from hitchopt.storage.interrupts import how_to_end
    from hitchopt.view.live import open_server, server_address

    plan = _load_content(path)  # before a page is opened
    server = open_server(host, port)
    address = server_address(server)
    say(f"the plan is at {address}; {how_to_end()}")
    if browser:  # in a thread, as some browsers return late
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    close = server.stop
    try:
        close = _serve(server, plan, ghost or (recording if is_flight else None)).close
        threading.Event().wait()
    finally:
        close()


def _save(
    file: Path,
    path: Path,
    recording: Path | None,
    page: tuple[float | None, float | None, list[str] | None],
) -> None:
    """Write a plan as a page, picture or film, or the film of a simulated flight of it."""
    from hitchopt.view.film import save_film
    from hitchopt.view.pictures import Page
    from hitchopt.view.report import save_view
    from hitchopt.view.scene import ghost_scene

    layout = Page.of(*page)
    plan = _load_content(path)
    with ProgressBar("certifying and drawing") as progress:
        if recording is None:
            certificate = plan.certificate if isinstance(plan, ho.Plan) else ho.certify(plan)
            content = plan.flight, certificate, plan.title, plan.problem
            save_view(file, *content, progress, layout)
        else:
            scene = ghost_scene(recording, plan.flight)
            title = f"{plan.title} (flown)".strip()
            save_film(file, scene, title, lambda x: progress(f"drawing the film, {x:.0%}"))
    say(f"wrote {file}", file=str(file))


def _load_content(path: Path) -> ho.Plan | SavedPlan:
    """Return the plan of a problem file, or a saved one, which is not certified yet."""
    from hitchopt.motion.plan_file import read_saved_plan
    from hitchopt.storage.yaml_file import read_text

    if path.suffix not in SUFFIXES:
        return read_saved_plan(plan_path(path))
    problem, text = ho.load_problem(path), read_text(path)[0]
    with ProgressBar("planning") as progress:
        plan = ho.solve(problem, progress=progress)
    return replace(plan, problem=text)


def _serve(server: Any, plan: ho.Plan | SavedPlan, ghost: Path | None) -> LiveView:
    """Show a plan in the page of a server."""
    from hitchopt.view.live import LiveView
    from hitchopt.view.scene import ghost_scene

    certificate = plan.certificate if isinstance(plan, ho.Plan) else None
    other = None if ghost is None else ghost_scene(ghost, plan.flight)
    live = LiveView(server, plan.flight, certificate, plan.title, other)
    if certificate is None:
        connected = threading.Event()
        server.on_client_connect(lambda _: connected.set())
        if connected.wait(LOADING_TIME):
            time.sleep(DRAWING_TIME)
        with ProgressBar("certifying"):
            certificate = ho.certify(plan)
        live.show_certificate(certificate)
    return live
