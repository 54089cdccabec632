"""Pictures of the live view and of reports, for the gallery: ``make screenshots`` takes them."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

import hitchopt as ho
from generators.problem_collection import PICTURES, PROBLEMS

FOLDER = PICTURES.with_name("pages")

SIZE = (1200, 800)
"""Width and height of a page [pixels]."""

SETTLED = 4000
"""Time after which a page has drawn what it was sent [ms]; software draws slowly."""

PALETTE, ROUNDS = 255, 3
"""Number of colours of a picture, and rounds in which they are fitted: thin cables keep theirs."""


@dataclass(frozen=True)
class Shown:
    """A moment of a problem's plan.

    Attributes
    ----------
    file: of the problem, relative to ``problems``.
    share: of the plan's duration that has passed.
    words: what is to be seen.
    """

    file: str
    share: float
    words: str

    def picture(self, kind: str) -> Path:
        """Return the path of the picture of its view or report."""
        return FOLDER / f"{Path(self.file).stem}_{kind}.png"


SCREENSHOTS = (
    Shown("carry_box.yaml", 0.55, "a box on the clasps of a square hitch"),
    Shown("swarms/circle_24.yaml", 0.45, "24 drones on their way across a circle"),
    Shown("form_thirty_gon.yaml", 1.0, "30 robots that have tied a hitch"),
)

KINDS = {"view": "the live view", "report": "`report.html`"}
"""What is shown of each, and what it is called."""


def take(shown: Shown) -> None:
    """Take the pictures of a plan's live view and report."""
    from generators.headless_page import opened_page  # Playwright is not needed to show them

    plan = ho.solve(PROBLEMS / shown.file)
    time = shown.share * plan.duration
    with TemporaryDirectory() as folder, opened_page(SIZE) as page:
        page.goto(f"{plan.report(folder).as_uri()}#t={time:.2f}")
        page.wait_for_function("Boolean(window.hitchopt)")
        _save(page, shown.picture("report"))
    live = plan.view(browser=False)
    assert live is not None
    with opened_page(SIZE) as page:
        page.goto(f"{live.url}/?fixedDpr=1")  # as sharp as on a graphics card
        page.wait_for_selector("canvas")
        live.seek(time)
        page.wait_for_timeout(SETTLED)
        page.add_style_tag(content=".mantine-Notifications-root { display: none }")
        _save(page, shown.picture("view"))
    live.close()


def _save(page: Any, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    page.wait_for_timeout(SETTLED)
    page.screenshot(path=path)
    image = Image.open(path).convert("RGB")
    image.quantize(PALETTE, kmeans=ROUNDS, dither=Image.Dither.NONE).save(path, optimize=True)
    sys.stdout.write(f"{path}\n")
    sys.stdout.flush()


def main() -> None:
    """Take all pictures."""
    for shown in SCREENSHOTS:
        take(shown)


if __name__ == "__main__":
    main()
