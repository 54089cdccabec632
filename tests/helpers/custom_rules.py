"""A custom rule, as users write them."""

from __future__ import annotations

import hitchopt as ho


def leg_angle(limit: float = 1e6) -> ho.Rule[ho.ClaspSpans]:
    """Return a lower limit of the angle between the two legs at a clasp."""
    return ho.Rule(
        "leg_angle",
        "deg",
        "min",
        limit,
        ho.ClaspSpans,
        lambda clasp: clasp.q_leg.angle_to(clasp.r_leg),
        "keep vertices apart",
    )
