"""The commands report and view: a plan to look at."""

from __future__ import annotations

import threading
import time
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.options import PATH, command, option, plan_path
from hitchopt.cli.output import ProgressBar, say
from hitchopt.cli.planning import SUFFIXES
from hitchopt.errors import FileError, HitchoptError, InputError

if TYPE_CHECKING:
    from hitchopt.view.live import LiveView

PROBLEM = "problem.yaml"  # Name under which an edited problem is saved next to its plan
# Times for which the processor is left to the browser [s]: until it has loaded the page, and
# after that to draw the first picture, as graphics cards are not everywhere
PATIENCE, DRAWING = 3.0, 1.5


@command(
    "directory DIR",
    option("--ghost", "Show another plan, a flight or an evaluation too.", PATH, "PATH"),
)
def report(directory: Path, ghost: Path | None) -> None:
    """Write DIR/report.html: the plan in one file that needs no network.

    It plays the plan in three dimensions, with plots of separation, speed, thrust and tension, the
    certificate, the phases, the problem file, versions and digests.
    """
    place = plan_path(directory).parent
    with ProgressBar("certifying and writing"):
        path = ho.load(place).report(place, ghost=ghost)
    say(f"open {path} in a browser", file=str(path))


@command(
    "path DIR|FILE",
    option("--save", "Write a page, picture or film; do not serve.", PATH, "FILE"),
    option(
        "--ghost",
        "Show another plan, a simulated flight or an evaluation at its side.",
        PATH,
        "PATH",
    ),
    option("--host", "Address to listen on; by default this machine.", "127.0.0.1", "TEXT"),
    option("--port", "Port to listen on, or the next free one.", 8080, "INTEGER"),
    option("--browser/--no-browser", "Whether to open the browser.", True),
)
def view(
    path: Path, save: Path | None, ghost: Path | None, host: str, port: int, *, browser: bool
) -> None:
    """Show the plan in DIR in the browser, live, and edit it by hand; Ctrl-C ends it (needs viser).

    Of a problem FILE (.yaml) the plan is made first. What is dragged is planned again, and Save
    writes the problem file: FILE, or DIR/problem.yaml.

    With --save FILE nothing is served: .html is the report; .png, .svg and .pdf are the summary;
    .mp4 and .gif are a film (needs imageio). Of a simulated flight, DIR/simulation, the film is
    saved, and live it is the ghost of its plan.
    """
    from hitchopt.storage.archive import PLAN, RECORDING

    recording = path / RECORDING if path.is_dir() and not (path / PLAN).exists() else path
    flown = recording.name == RECORDING and recording.is_file()
    if flown:
        path = recording.resolve().parent.parent
        if not (path / PLAN).is_file():
            raise FileError(f"{recording}: its plan is not in {path}; keep the two together")
    if save is not None:
        if ghost is not None:
            words = "no ghost where a plan is written to a file"
            raise InputError("ghost", str(ghost), words, "leave --save out: it is shown live")
        _save(save, path, recording if flown else None)
        return
    from hitchopt.view.live import open_server, server_address

    shown = _shown(path)  # before a page is opened for it
    file = path if path.suffix in SUFFIXES else plan_path(path).with_name(PROBLEM)
    server = open_server(host, port)
    address = server_address(server)
    say(f"the plan is at {address}; Ctrl-C ends this")
    if browser:  # it loads the page while the plan is read; some browsers return late
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    close = server.stop
    try:
        close = _serve(server, shown, file, ghost or (recording if flown else None)).close
        threading.Event().wait()
    finally:
        close()


def _save(file: Path, path: Path, recording: Path | None) -> None:
    """Write a plan as a page, picture or film, or the film of a simulated flight of it."""
    from hitchopt.view.film import save_film
    from hitchopt.view.report import save_view
    from hitchopt.view.scene import ghost_scene

    motion, certificate, title, text = _shown(path)
    with ProgressBar("certifying and drawing") as tell:
        if recording is None:
            save_view(file, motion, certificate or ho.certify(motion), title, text, tell)
        else:
            scene, words = ghost_scene(recording, motion), f"{title} (flown)".strip()
            save_film(file, scene, words, lambda done: tell(f"drawing the film, {done:.0%}"))
    say(f"wrote {file}", file=str(file))


def _shown(path: Path) -> tuple[ho.Motion, ho.Certificate | None, str, str]:
    """Return motion, certificate, title and problem's text; one in a directory is not certified."""
    from hitchopt.motion.plan_file import read_saved_plan
    from hitchopt.storage.yaml_file import read_text

    if path.suffix not in SUFFIXES:
        saved = read_saved_plan(plan_path(path))
        return saved.motion, None, saved.title, saved.problem
    problem, text = ho.read_problem(path), read_text(path)[0]
    with ProgressBar("planning") as progress:
        plan = ho.solve(problem, progress)
    return plan.motion, plan.certificate, plan.title, text


def _serve(
    server: Any,
    shown: tuple[ho.Motion, ho.Certificate | None, str, str],
    file: Path,
    ghost: Path | None,
) -> LiveView:
    """Show a plan in the page of a server, to be edited there and saved to ``file``."""
    from hitchopt.steps.certified_motions import CertifiedMotion
    from hitchopt.view.editing import Editing
    from hitchopt.view.live import LiveView
    from hitchopt.view.panel import EditingPanel
    from hitchopt.view.scene import ghost_scene

    motion, certificate, title, text = shown
    other = None if ghost is None else ghost_scene(ghost, motion)
    live = LiveView(server, motion, certificate, title, other)
    if certificate is None:
        loaded = threading.Event()
        server.on_client_connect(lambda _: loaded.set())
        if loaded.wait(PATIENCE):
            time.sleep(DRAWING)
        with ProgressBar("certifying"):
            certificate = ho.certify(motion)
        live.show_certificate(certificate)
    try:
        editing = Editing(text, file, CertifiedMotion(live.motion, certificate))
    except HitchoptError as error:
        say(f"it cannot be edited here: {error}")
    else:
        EditingPanel(live, editing)
    return live
