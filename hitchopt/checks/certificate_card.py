"""HTML of certificates and other tables, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hitchopt.checks.certificate import Certificate

MAX_ROWS = 40
"""Most rows of a table; the others are counted."""


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table with its texts escaped."""
    listed = list(rows)
    lines = ["".join(f"<th>{escape(head)}</th>" for head in heads)]
    lines += ["".join(f"<td>{escape(text)}</td>" for text in row) for row in listed[:MAX_ROWS]]
    if len(listed) > MAX_ROWS:
        lines.append(f"<td colspan='{len(heads)}'>and {len(listed) - MAX_ROWS} more</td>")
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def certificate_card(certificate: Certificate) -> str:
    """Return the verdict and the table of the checks, each with its worst value for all t."""
    rows = []
    for check in certificate.checks:
        relation = "≥" if check.sense == "min" else "≤"
        limit = "–" if check.limit is None else f"{relation} {check.limit:.6g}"
        worst = "–" if check.worst is None else f"{check.worst:.6g}"
        where = " ".join(check.where[:4]) + (" …" if len(check.where) > 4 else "")
        verdict = "yes" if check.holds else "NO"
        rows.append((check.name, worst, limit, check.unit, where, f"{check.time:.3f} s", verdict))
    violated = ", ".join(check.name for check in certificate.violated)
    verdict = f"not certified: {violated}" if violated else "certified for all t"
    heads = ("check", "worst", "limit", "unit", "where", "when", "holds")
    return f"<p><b>{escape(verdict)}</b></p>{html_table(heads, rows)}"
