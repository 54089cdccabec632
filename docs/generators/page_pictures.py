"""Pictures of live views and reports for the gallery: ``make screenshots`` takes them."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

import hitchopt as ho
from generators.problem_collection import GALLERY, PROBLEMS

SCREENSHOTS = {"carry_box": 0.55, "swarms/circle_24": 0.45, "form_thirty_gon": 1.0}
"""Problems, and times of the pictures as fractions of the plan's duration."""

KINDS = {"view": "The live view", "report": "The report"}

SIZE = (1200, 800)
"""Width and height of a page [pixels]."""

DRAWING_TIME = 4000
"""Time in which a page draws new content with software rendering [ms]."""

PALETTE, ROUNDS = 255, 3
"""Number of colours of a picture, and iterations of their fit, enough for thin cables."""


def screenshot(stem: str, kind: str) -> Path:
    """Return the path of the picture of a problem's view or report."""
    return GALLERY / "pages" / f"{Path(stem).name}_{kind}.png"


def take(stem: str, share: float) -> None:
    """Take the pictures of a plan's live view and report."""
    from generators.headless_page import opened_page  # Playwright is only needed here

    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    time = share * plan.duration
    with TemporaryDirectory() as folder, opened_page(SIZE) as page:
        page.goto(f"{plan.report(folder).as_uri()}#t={time:.2f}")
        page.wait_for_function("Boolean(window.hitchopt)")
        _save(page, screenshot(stem, "report"))
    live = plan.view(browser=False)
    assert live is not None
    with opened_page(SIZE) as page:
        page.goto(f"{live.url}/?fixedDpr=1")  # as sharp as on a graphics card
        page.wait_for_selector("canvas")
        live.seek(time)
        page.wait_for_timeout(DRAWING_TIME)
        page.add_style_tag(content=".mantine-Notifications-root { display: none }")
        _save(page, screenshot(stem, "view"))
    live.close()


def _save(page: Any, path: Path) -> None:
    page.wait_for_timeout(DRAWING_TIME)
    page.screenshot(path=path)
    image = Image.open(path).convert("RGB")
    image.quantize(PALETTE, kmeans=ROUNDS, dither=Image.Dither.NONE).save(path, optimize=True)
    sys.stdout.write(f"{path}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    for stem, share in SCREENSHOTS.items():
        take(stem, share)
