"""A plan written to a file to look at; the ending of its name says as what."""

from __future__ import annotations

from pathlib import Path

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, InputError
from hitchopt.motion.motion import Motion
from hitchopt.time_limit import Progress

PICTURES = (".png", ".svg", ".pdf")

PAGE = ".html"

FILMS = (".mp4", ".gif")


def save_view(
    path: Path,
    motion: Motion,
    certificate: Certificate,
    title: str = "",
    problem: str = "",
    progress: Progress | None = None,
) -> None:
    """Write a plan as a page, a picture or a film.

    Parameters
    ----------
    path: file, replaced if there is one; its name ends in one of PICTURES, PAGE or FILMS.
    motion, certificate, title: the plan.
    problem: the text of its problem file, if it is known.
    progress: called with what is done of a film.

    Raises
    ------
    InputError: another ending.
    UnsupportedError: a film needs a package that is not installed.
    FileError: the file cannot be written.
    """
    kind = path.suffix.lower()
    if kind in FILMS:
        from hitchopt.view.film import save_film
        from hitchopt.view.scene import scene_of

        def share(done: float) -> None:
            if progress is not None:
                progress(f"drawing, {done:.0%}")

        save_film(path, scene_of(motion), title, share)
        return
    if kind not in (*PICTURES, PAGE):
        bound = f"a name in {', '.join((PAGE, *PICTURES, *FILMS))}"
        raise InputError("--save", str(path), bound, "such as plan.html")
    draft = path.with_name(f".{path.stem}.part{kind}")
    try:
        if kind == PAGE:
            from hitchopt.view.html_report import write_report

            write_report(draft, motion, certificate, title, problem, path.parent)
        else:
            from hitchopt.view.summary import save_summary

            save_summary(draft, motion, certificate, title)
        draft.replace(path)
    except OSError as error:
        reason = error.strerror or error
        raise FileError(f"{path}: cannot be written: {reason}; name another place") from error
    finally:
        draft.unlink(missing_ok=True)
