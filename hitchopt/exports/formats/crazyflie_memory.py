"""The memory of a Crazyflie, and plans cut to fit into it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from math import inf

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.exports.formats.format import Arrangement, Format, Task
from hitchopt.exports.refit.piece_fitting import Kind, breaks_within
from hitchopt.motion.cutting import cut, rests
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

BYTES = 4096
"""Size of the memory for all trajectories of one drone [B]."""

UPLOAD_LAST = "goTo the point where each hovers and wait, only then upload the next"
"""A finished trajectory is evaluated from the memory that an upload overwrites; goTo is not."""

CLOSER = 0.3
"""Share of the error within which parts are refitted where coarser ones lose a limit."""


class CrazyflieFormat(Format):
    """A format of trajectories that are uploaded into a Crazyflie's memory.

    Attributes
    ----------
    kind: kind of its pieces.
    bound: largest error of a refit, over its scale.
    unit: name of the pieces.
    nearness: description of the bound.
    remedy: what to do about a plan that needs more memory.
    """

    frames = ("enu", "nwu")
    rate = 0.0
    kind: Kind
    bound: float
    unit: str
    nearness: str
    remedy: str

    @abstractmethod
    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many pieces of some curves memory holds."""

    def _holds(self, motion: Motion, share: float = 1.0) -> bool:
        """Return whether memory holds a motion within a share of the bound."""
        curves = motion.drones
        most = self.most_pieces(curves)
        return breaks_within(curves, self.kind, share * self.bound, most) is not None

    def _refusal(self, motion: Motion) -> InfeasibleError:
        """Return the error that memory does not hold a motion without a rest."""
        breaks = breaks_within(motion.drones, self.kind, self.bound)
        pieces = inf if breaks is None else len(breaks) - 1.0
        most = float(self.most_pieces(motion.drones))
        when = f"to stay {self.nearness} a plan of {motion.duration:.4g} s without a rest"
        return InfeasibleError(
            [Violation("memory", pieces, most, "max", self.unit, (), when, self.remedy)],
            "it cannot be cut either, as nothing rests in between; stream it: "
            "--format ros2bag (full-state setpoints), csv or mavsdk_drone_show",
        )

    def arrangements(self, task: Task) -> Iterator[Arrangement]:
        """Give the task as a whole if it fits, then cut at rests into as few parts as fit.

        Parts that are refitted too coarsely to keep the plan's limits are followed by closer ones.

        Raises
        ------
        InfeasibleError: between two rests there is more than fits.
        """
        motion = task.motion
        whole = self._holds(motion)
        if whole:
            yield Arrangement((task,))
        at = rests(motion).tolist()
        if len(at) == 2:
            if not whole:
                raise self._refusal(motion)
            return
        before = 1
        for share in (1.0, CLOSER):
            parts: list[Task] = []
            first = 0
            while first < len(at) - 1:
                last = first + 1
                part = cut(motion, at[first], at[last])
                if not self._holds(part, share):
                    if share < 1.0:
                        return
                    raise self._refusal(part)
                # All of the plan in one part has been tried before.
                while last + 1 < len(at) and (first, last + 2) != (0, len(at)):
                    longer = cut(motion, at[first], at[last + 1])
                    if not self._holds(longer, share):
                        break
                    part, last = longer, last + 1
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
