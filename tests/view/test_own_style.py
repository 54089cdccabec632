"""Pictures in hitchopt's own style, whatever style users have."""

from __future__ import annotations

import ast
import io
import re
from functools import cache
from typing import Any

import matplotlib as mpl
import pytest

from hitchopt.view.pictures import draw_summary
from hitchopt.view.style import save_figure
from tests.helpers.plans import ROOT, planned

STYLES: list[dict[str, Any]] = [
    {"text.usetex": True, "savefig.dpi": 30, "savefig.bbox": "tight"},
    {"font.family": "A Font That Nobody Has", "font.size": 30.0, "path.sketch": (1.0, 100.0, 2.0)},
    {"axes.edgecolor": "w", "axes.facecolor": "k", "savefig.facecolor": "k", "text.color": "w"},
]


def picture() -> bytes:
    """Return the summary of a plan as a file."""
    plan, file = planned("triangle"), io.BytesIO()
    save_figure(draw_summary(plan.flight, plan.certificate, plan.title), file, 60)
    return file.getvalue()


@cache
def plain_picture() -> bytes:
    """Return the summary in the style of matplotlib."""
    return picture()


@pytest.mark.parametrize("style", STYLES, ids=lambda style: next(iter(style)))
def test_pictures_are_those_without_the_users_style(style: dict[str, Any]) -> None:
    expected = plain_picture()
    with mpl.rc_context():
        settings: Any = style
        mpl.rcParams.update(settings)
        chosen = dict(mpl.rcParams)
        assert picture() == expected
        assert dict(mpl.rcParams) == chosen


def test_cards_of_notebooks_need_no_tex() -> None:
    plan = planned("triangle")
    with mpl.rc_context({"text.usetex": True}):
        assert "data:image/png" in plan._repr_html_()


def test_all_figures_are_drawn_in_the_own_style() -> None:
    """Functions that return a figure, or write one, are decorated; helpers of style.py are not."""
    drawing, plain = list[str](), list[str]()
    for path in sorted((ROOT / "hitchopt").rglob("*.py")):
        if "Figure" not in (text := path.read_text("utf-8")):
            continue
        for node in ast.parse(text).body:
            if not isinstance(node, ast.FunctionDef) or node.name in ("new_figure", "page_figure"):
                continue
            draws = node.returns is not None and re.search(r"\bFigure\b", ast.unparse(node.returns))
            if draws or node.name in ("save_figure", "save_film"):
                decorators = map(ast.unparse, node.decorator_list)
                styled = any(each.endswith("own_style()") for each in decorators)
                (drawing if styled else plain).append(f"{path.name}:{node.name}")
    assert len(drawing) >= 9
    assert not plain
