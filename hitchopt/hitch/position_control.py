"""The position loop of a drone, and when it leaves the cables' tension undetermined."""

from __future__ import annotations

INTEGRAL = (
    "an integral in the position loop drives the position error to zero, whatever the tension: the "
    "cables' lengths set it, and a centimetre changes it by a multiple; turn it off, or measure "
    "tensions"
)
"""What is wrong with an integral."""

NO_FEED_FORWARD = (
    "without feed-forward of the cable force nothing keeps up the planned tension: drones give way "
    "until cables hardly pull; export with --hold-tension, which moves the set points outward"
)
"""What is wrong without feed-forward."""


def undetermined_tension(*, integral: bool, feed_forward: bool) -> tuple[str, ...]:
    """Return in words why a plan does not determine the tensions; nothing where it does."""
    found = (INTEGRAL,) if integral else ()
    return found if feed_forward else (*found, NO_FEED_FORWARD)
