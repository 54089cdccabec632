"""Check of the built documentation in a headless Chromium: ``make site``.

No page logs an error or asks another machine, none is wider than the screen of a phone, and a search
finds what readers look for. Pictures of the most read pages go to
``docs/_build/screenshots``.
"""

from __future__ import annotations

import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

from generators.headless_page import opened_page
from generators.problem_collection import ROOT

SITE = ROOT / "docs" / "_build" / "html"

PICTURES = SITE.with_name("screenshots")

SIZES = {"desktop": (1280, 900), "phone": (390, 844)}
"""Width and height of the screens [pixels]."""

SHOWN = ("index", "tutorials/carry_a_box", "how_to/fly_faster", "gallery/index")
"""Pages of which pictures are taken."""

SEARCHES = {
    "clasp": "explanation/clasp",
    "separation 1.05": "how_to/read_separation",
    "fly faster": "how_to/fly_faster",
    "exit code 3": "how_to/exit_code_3",
    "crazyflie": "how_to/crazyflie",
}
"""What readers look for, and the page that tells it."""

FIRST = 5
"""Number of results among which the page has to be."""


def look(page: Any, address: str, name: str, size: str) -> list[str]:
    """Open a page, and return what is wrong with it on a screen."""
    page.goto(f"{address}/{name}.html")
    wide = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    if name in SHOWN:
        PICTURES.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=PICTURES / f"{name.replace('/', '_')}_{size}.png")
    return [f"{name}: {wide} pixels wider than a {size}"] if wide > 0 else []


def search(page: Any, address: str, words: str) -> list[str]:
    """Return the first results of a search."""
    page.goto(f"{address}/search.html?q={words.replace(' ', '+')}")
    page.wait_for_selector("#search-results ul.search li a")
    page.wait_for_function(
        "!document.querySelector('#search-progress')?.textContent.includes('...')"
    )
    found = page.locator("#search-results ul.search > li > a")
    links = [found.nth(i).get_attribute("href") for i in range(min(found.count(), FIRST))]
    return [link.partition(".html")[0] for link in links]


def _pages(site: Path) -> list[Path]:
    return sorted(path for path in site.rglob("*.html") if "_static" not in path.parts)


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


def main() -> int:
    """Check the site; print what is wrong and return whether anything is."""
    names = [path.relative_to(SITE).with_suffix("").as_posix() for path in _pages(SITE)]
    wrong: list[str] = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(SITE)))
    Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    for size, pixels in SIZES.items():
        with opened_page(pixels) as page:
            wrong += [each for name in names for each in look(page, address, name, size)]
    with opened_page() as page:
        for words, target in SEARCHES.items():
            found = search(page, address, words)
            if target not in found:
                wrong.append(f"a search for {words!r} finds {', '.join(found)}")
    server.shutdown()
    sys.stdout.write("\n".join([*wrong, f"{len(names)} pages, {len(wrong)} faults", ""]))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
