"""Check of the built documentation in a headless Chromium: ``make site``.

No page logs an error, accesses another machine or is wider than a phone's screen, and searches find
the expected pages. Sphinx checks internal links during the build.
"""

from __future__ import annotations

import sys
from typing import Any

from generators.headless_page import opened_page, served
from generators.problem_collection import ROOT

SITE = ROOT / "docs" / "_build" / "html"

SCROLLING = """[...document.querySelectorAll('.bd-article pre')]
    .filter((block) => block.scrollWidth > block.clientWidth + 1).length"""
"""Number of blocks of code that are wider than their place, as JavaScript."""

PHONE = (390, 844)
"""Width and height of a small screen [pixels]."""

SEARCHES = {
    "clasp": "reference/index",
    "separation 1.05": "explanation/certificate",
    "fly faster": "how_to/write_a_problem",
    "exit code 3": "how_to/exit_code_3",
    "crazyflie": "how_to/export",
    "obstacle": "how_to/carry",
    "thread": "how_to/describe_your_drones",
    "delay": "how_to/before_you_fly",
    "trim": "how_to/calibrate",
    "cite": "index",
}
"""Searches, and pages that must be among the first MAX_RESULTS results."""

MAX_RESULTS = 5


def results(page: Any, address: str, words: str) -> list[str]:
    """Return the first results of a search."""
    page.goto(f"{address}/search.html?q={words.replace(' ', '+')}")
    page.wait_for_selector("#search-results ul.search li a")
    page.wait_for_function(
        "!document.querySelector('#search-progress')?.textContent.includes('...')"
    )
    links = page.locator("#search-results ul.search > li > a").all()[:MAX_RESULTS]
    return [link.get_attribute("href").partition(".html")[0] for link in links]


def main() -> int:
    """Check the site, print its faults and return the exit code."""
    files = sorted(path for path in SITE.rglob("*.html") if "_static" not in path.parts)
    faults: list[str] = []
    with served(SITE) as address, opened_page(PHONE) as page:
        for name in (file.relative_to(SITE).as_posix() for file in files):
            page.goto(f"{address}/{name}")
            excess = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
            faults += [f"{name}: {excess} pixels wider than a phone"] if excess > 0 else []
            scrolls = page.evaluate(SCROLLING)
            faults += [f"{name}: {scrolls} blocks of code scroll"] if scrolls else []
        for words, target in SEARCHES.items():
            if target not in (pages := results(page, address, words)):
                faults.append(f"a search for {words!r} lists {', '.join(pages)}")
    sys.stdout.write("\n".join([*faults, f"{len(files)} pages, {len(faults)} faults", ""]))
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
