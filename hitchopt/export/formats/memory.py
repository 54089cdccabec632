"""The memory of a Crazyflie, and plans cut to fit into it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.export.cutting import cut, rests
from hitchopt.export.formats.format import Arrangement, Task
from hitchopt.model.motion import Flying

BYTES = 4096
"""For all trajectories of one drone."""


def arrangements(
    task: Task, fits: Callable[[Flying], bool], needed: Callable[[Flying], Violation]
) -> Iterator[Arrangement]:
    """Give the task as a whole if it fits, then cut at rests into as few parts as fit.

    Parameters
    ----------
    task: the plan.
    fits: whether a motion can be refitted within memory and accuracy.
    needed: what to say of one that cannot.

    Raises
    ------
    InfeasibleError: between two rests there is more than fits.
    """
    whole = fits(task.motion)
    if whole:
        yield Arrangement((task,))
    motion = task.motion
    at = rests(motion).tolist()
    if len(at) == 2:
        if not whole:
            raise _left_to_streaming(needed(motion))
        return
    parts = []
    first = 0
    while first < len(at) - 1:
        last = first + 1
        if not fits(cut(motion, at[first], at[last])):
            raise _left_to_streaming(needed(cut(motion, at[first], at[last])))
        while last + 1 < len(at) and fits(cut(motion, at[first], at[last + 1])):
            last += 1
        parts.append(replace(task, motion=cut(motion, at[first], at[last])))
        first = last
    if len(parts) > 1:
        yield Arrangement(
            tuple(parts),
            f"the plan is cut into {len(parts)} parts at rests, since a drone's memory of {BYTES} "
            "bytes does not hold it whole: fly one, upload the next while the drones hover, go on",
        )


def _left_to_streaming(violation: Violation) -> InfeasibleError:
    return InfeasibleError(
        [violation],
        "it cannot be cut either, as nothing rests in between; stream it: "
        "--format ros2bag (full-state setpoints), csv or mavsdk_drone_show",
    )
