"""Whether the steps of a mission fit the team, the outlines they meet and one another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.objects import SolidObject
from hitchopt.steps import STEPS, FollowVertex, Step
from hitchopt.steps.hitch_step import MoveStep
from hitchopt.steps.step import Stage
from hitchopt.values import text


def fitting_steps(
    team: Team,
    outline: Outline | None,
    steps: tuple[Step, ...],
    objects: Mapping[str, SolidObject] | None = None,
) -> tuple[Step, ...]:
    """Return the steps with their polygons as outlines and their legs as arrays.

    Parameters
    ----------
    team: who flies them.
    outline: the hitch's at the start; None where cables are free.
    steps: with polygons and legs as a user writes them.
    objects: those that steps may name.

    Raises
    ------
    InputError: a step that does not fit the team, the outline it meets, the object that is held, or
        the next step; its key is that of the problem file, from ``mission`` on.
    """
    fitted: list[Step] = []
    held = _Held()
    for i, given in enumerate(steps):
        try:
            step = given.fitting(team)
            held = held.after(step, objects or {})
            outline = step.polygon_left(team, outline)
            _check_blend(step, steps[i + 1] if i + 1 < len(steps) else None)
            if i > 0 and steps[i - 1].blends:
                _check_untimed(step)
        except InputError as error:
            raise error.within(f"mission[{i}].{given.name}") from None
        fitted.append(step)
    return tuple(fitted)


@dataclass(frozen=True)
class _Held:
    """How far a hitch is with which object, and whether its outline is that of an earlier step.

    Attributes
    ----------
    stage: how far.
    name: of the object, or an empty word.
    known: whether the outline is; that around an object follows from the object.
    """

    stage: Stage = Stage.FREE
    name: str = ""
    known: bool = True

    def after(self, step: Step, objects: Mapping[str, SolidObject]) -> _Held:
        """Return the same after a step, or raise InputError where that does not fit."""
        name = text("object", getattr(step, "object", self.name))
        if name and name not in objects:
            bound = f"one of objects: {', '.join(objects)}" if objects else "an object of the file"
            raise InputError("object", name, bound, "list it under objects")
        if step.stages is None:
            return self
        begin, end = step.stages
        if self.stage is not begin:
            raise InputError("", f"a hitch {self.stage}", f"one {begin}", ORDER)
        if begin is not Stage.FREE and name != self.name:
            raise InputError("object", name, f"{self.name}, the one enclosed", "leave that before")
        if not self.known and isinstance(step, MoveStep | FollowVertex):
            bound = "given an outline of the file"
            raise InputError("", "the outline around an object", bound, "morph before")
        shaped = getattr(step, "polygon", None) is not None
        known = shaped or (self.known and not hasattr(step, "object"))
        return _Held(end, "" if end is Stage.FREE else name, known)


ORDER = "enclose, grasp, lift, carry, set_down, loosen and leave an object, in this order"
"""What to do with an object."""


def _check_blend(step: Step, following: Step | None) -> None:
    if not step.blends:
        return
    if following is None:
        raise InputError("blend", True, "false in the last step", "leave it out: nothing follows")
    if not following.blendable:
        names = ", ".join(kind.name for kind in STEPS if kind.blendable)
        remedy = f"leave it out: only {names} go on into one another"
        raise InputError("blend", True, f"false before a {following.name}", remedy)
    _check_untimed(step)


def _check_untimed(step: Step) -> None:
    not_optimised = "whose path is not optimised"
    for key, value, reason in (
        ("optimize", getattr(step, "optimize", None), not_optimised),
        ("tension", getattr(step, "tension", None), not_optimised),
        ("duration", step.given_duration, "which have no stop to end with"),
    ):
        if value:
            bound = f"left out of steps that are blended, {reason}"
            raise InputError(key, value, bound, f"leave out {key} or blend")
