"""Formulas as MathML, which browsers render without external scripts."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert


def visit_math(translator: Any, node: Any) -> None:
    """Write an inline formula."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_displayed_math(translator: Any, node: Any) -> None:
    """Write a displayed formula."""
    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div class="formula">{formula}</div>\n')
    raise nodes.SkipNode


def add_renderer(app: Any) -> None:
    """Register the renderer in Sphinx; ``html_math_renderer`` selects it."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displayed_math, None))
