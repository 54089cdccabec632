"""Cable clearances of regular n-gons, which shrink with n: what tables say of them."""

from __future__ import annotations

import hitchopt as ho

DEFAULT = ho.Separation().cable
"""Cable clearance of a problem that gives none [m]."""

HEADING = "cable [mm]"
"""Heading of a table's column of clearances."""

NOTE = f"{HEADING}: the cable clearance that is kept; * below the default of {1e3 * DEFAULT:g} mm"
"""Footnote of tables with such a column."""


def clearance_text(clearance: float) -> str:
    """Return a cable clearance [m] in millimetres, with an asterisk below the default."""
    return f"{1e3 * clearance:.3g}{'*' if clearance < DEFAULT else ''}"
