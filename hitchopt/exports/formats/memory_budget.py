"""The memory of a Crazyflie, and plans cut to fit into it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.exports.formats.format import Arrangement, Task
from hitchopt.motion.cutting import cut, rests
from hitchopt.motion.motion import Motion

BYTES = 4096
"""For all trajectories of one drone."""

UPLOAD_LAST = "goTo the point where each hovers and wait, only then upload the next"
"""A finished trajectory is evaluated from the memory that an upload overwrites; goTo is not."""

CLOSER = 0.3
"""Of the accuracy, that parts are refitted within where coarser ones lose a limit."""


def arrangements(
    task: Task,
    fits: Callable[[Motion, float], bool],
    needed: Callable[[Motion], Violation],
) -> Iterator[Arrangement]:
    """Give the task as a whole if it fits, then cut at rests into as few parts as fit.

    Parts that are refitted too coarsely to keep the plan's limits are followed by closer ones.

    Parameters
    ----------
    task: the plan.
    fits: whether a motion can be refitted within memory and a share of the accuracy.
    needed: what to say of one that cannot.

    Raises
    ------
    InfeasibleError: between two rests there is more than fits.
    """
    whole = fits(task.motion, 1.0)
    if whole:
        yield Arrangement((task,))
    motion = task.motion
    at = rests(motion).tolist()
    if len(at) == 2:
        if not whole:
            raise _left_to_streaming(needed(motion))
        return
    before = 1
    for share in (1.0, CLOSER):
        parts: list[Task] = []
        first = 0
        while first < len(at) - 1:
            last = first + 1
            if not fits(cut(motion, at[first], at[last]), share):
                if share < 1.0:
                    return
                raise _left_to_streaming(needed(cut(motion, at[first], at[last])))
            while _more(first, last, len(at)) and fits(cut(motion, at[first], at[last + 1]), share):
                last += 1
            part = cut(motion, at[first], at[last])
            begins = float(motion.drones.breaks[at[first]])
            parts.append(replace(task, motion=part, begins=begins, number=len(parts) + 1))
            first = last
        if len(parts) > before:
            before = len(parts)
            why = "loses a limit in so few pieces" if whole else "does not fit"
            yield Arrangement(
                tuple(replace(part, count=len(parts)) for part in parts),
                f"the plan is cut into {len(parts)} parts at rests, since as a whole it {why} "
                f"(a drone's memory holds {BYTES} bytes): fly one and let the drones hover, "
                f"{UPLOAD_LAST}, go on",
            )


def _more(first: int, last: int, rests: int) -> bool:
    """Return whether a part may go on to the next rest; all of the plan has been tried before."""
    return last + 1 < rests and (first, last + 2) != (0, rests)


def _left_to_streaming(violation: Violation) -> InfeasibleError:
    return InfeasibleError(
        [violation],
        "it cannot be cut either, as nothing rests in between; stream it: "
        "--format ros2bag (full-state setpoints), csv or mavsdk_drone_show",
    )
