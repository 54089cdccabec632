"""The API reference: one page for every group of public names, in the order of this list."""

from __future__ import annotations

import inspect

import hitchopt as ho

GROUPS = {
    "plan": ("Planning", ("hitchopt.api",)),
    "results": (
        "Plans",
        ("hitchopt.plan", "hitchopt.motion", "hitchopt.trajectory"),
    ),
    "teams": ("Teams and hitches", ("hitchopt.hitch", "hitchopt.geometry")),
    "problems": (
        "Problems and steps",
        ("hitchopt.mission", "hitchopt.steps", "hitchopt.planners"),
    ),
    "requirements": ("Requirements", ("hitchopt.hitch.requirements", "hitchopt.objects")),
    "certificates": ("Certificates", ("hitchopt.checks",)),
    "fleets": ("Fleets", ("hitchopt.exports",)),
    "fits": ("Fits", ("hitchopt.statics.fit", "hitchopt.hitch.holding")),
    "stopping": (
        "Stops, steering and feedback",
        ("hitchopt.live",),
    ),
    "statics": ("Statics and tolerance", ("hitchopt.statics.settle", "hitchopt.statics.tolerance")),
    "calibration": ("Calibration", ("hitchopt.statics", "hitchopt.simulation")),
    "sweeps": ("Sweeps", ("hitchopt.sweeps",)),
    "errors": ("Errors", ("hitchopt.errors",)),
    "others": ("Others", ("hitchopt",)),
}
"""Title and modules of every page; a name is on the first page that has its module."""


def write_api_pages() -> dict[str, str]:
    """Return the pages in reStructuredText, by their names, and their index."""
    pages = {
        page: _page(title, names)
        for page, (title, _) in GROUPS.items()
        if (names := [name for name in ho.__all__ if page_of(name) == page])
    }
    listed = "\n".join(f"   {page}" for page in pages)
    title = "Python API"
    words = "All public names are attributes of ``hitchopt``: ``import hitchopt as ho``."
    pages["index"] = f"{_title(title, '=')}\n{words}\n\n.. toctree::\n\n{listed}\n"
    return pages


def page_of(name: str) -> str:
    """Return the page on which a public name is."""
    module: str = vars(ho)["_MODULES"].get(name, "hitchopt")
    for page, (_, prefixes) in GROUPS.items():
        if any(module == prefix or module.startswith(f"{prefix}.") for prefix in prefixes):
            return page
    raise AssertionError(f"no page for {name} of {module}")


def _page(title: str, names: list[str]) -> str:
    functions = [name for name in names if inspect.isroutine(getattr(ho, name))]
    classes = [name for name in names if name not in functions]
    entries = [_entry(name) for name in (*functions, *classes)]
    return "\n".join([_title(title, "="), ".. currentmodule:: hitchopt\n", *entries])


def _entry(name: str) -> str:
    value = getattr(ho, name)
    if inspect.isroutine(value):
        return f".. autofunction:: hitchopt.{name}\n"
    if inspect.isclass(value):
        kind = "autoexception" if issubclass(value, BaseException) else "autoclass"
        return f".. {kind}:: hitchopt.{name}\n   :members:\n"
    return f".. autodata:: hitchopt.{name}\n"


def _title(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n"
