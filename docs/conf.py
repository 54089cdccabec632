"""Configuration of the documentation; ``make docs`` builds it."""

from __future__ import annotations

import os
import re
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from generators.math_markup import add_renderer  # noqa: E402
from generators.site_pages import write_pages  # noqa: E402

from hitchopt.steps import STEP_KINDS  # noqa: E402

project = "hitchopt"
author = "The hitchopt developers"
release = version = metadata.version("hitchopt")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_click",
    "sphinx_design",
]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True
nb_merge_streams = True
nb_render_markdown_format = "myst"

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "NDArray")}
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_default_options = {"members": True}
numpydoc_show_class_members = False
autosummary_filename_map = {
    f"hitchopt.{kind.__name__}": f"hitchopt.steps.{kind.__name__}" for kind in STEP_KINDS.values()
}
"""``hitchopt.Morph`` and ``hitchopt.morph`` are one file where cases are not distinguished."""
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!hitchopt\.\w+$).*")]
"""Signatures name types of other packages, and such as are not public."""

templates_path = ["_templates"]
html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "hitchopt"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_context = {"default_mode": "auto"}  # else the theme logs an error at the first visit
html_css_files = ["site.css"]
html_show_sourcelink = False
html_sidebars = {"gallery/**": []}
html_theme_options = {
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
project_copyright = "The hitchopt developers, MIT License"

# Commands in tutorials are those of the environment that builds them.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["COLUMNS"] = "100"
startup = HERE / "_build" / "ipython" / "profile_default" / "startup"
startup.mkdir(parents=True, exist_ok=True)
shutil.copy(HERE / "generators" / "bash_magic.py", startup)
os.environ["IPYTHONDIR"] = str(startup.parents[1])


def split_entries(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Put the text of ``name: text`` below its name, where numpydoc looks for it."""
    del app, what, name, obj, options
    entry = re.compile(r"^([\w.*`]+(?:, [\w.*`]+)*): (.*)$")
    first = next((i for i, line in enumerate(lines) if set(line) == {"-"}), len(lines))
    entries = [entry.sub(r"\1\n    \2", line) for line in lines[first:]]
    lines[first:] = [part for each in entries for part in each.split("\n")]


def name_aliases(*given: Any) -> tuple[str | None, str | None]:
    """Write aliases of types in signatures by their names."""
    return tuple(
        each and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", each) for each in given[-2:]
    )


def setup(app: Any) -> None:
    """Write the generated pages before Sphinx looks for pages."""
    write_pages()
    add_renderer(app)
    app.connect("autodoc-process-signature", name_aliases)
    app.connect("autodoc-process-docstring", split_entries, priority=100)  # before numpydoc
