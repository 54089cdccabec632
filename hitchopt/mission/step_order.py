"""The order of steps: which may follow which, and with which object, outline and blend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hitchopt.errors import Circumstance, InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.mission.starts import words_of
from hitchopt.objects import SolidObject
from hitchopt.steps import STEP_KINDS
from hitchopt.steps.step import Stage, Step
from hitchopt.values import closest_word, text


def resolved_steps(
    name: str,
    team: Team,
    steps: tuple[Step, ...],
    outline: Outline | None,
    objects: Mapping[str, SolidObject],
) -> tuple[Step, ...]:
    """Return steps with their polygons as outlines and their legs as arrays.

    Raises InputError, with a key from ``mission`` on, for a step that does not fit the team, the
    outline, the held object or the next step.

    Parameters
    ----------
    name: of the team; empty for a team alone.
    outline: at the start; None for free cables and single drones.
    """
    resolved = list[Step]()
    stage = ObjectStage()
    reason = "start has no hitch" if outline is None else "start is a hitch"
    for i, unresolved in enumerate(steps):
        try:
            if unresolved.of_single_drones is team.has_cables:
                expected = words_of(team)
                other = Circumstance(f"{name or 'this'} is {expected.kind}")
                raise InputError("", other, expected.step, f"use {expected.step}")
            step = unresolved.resolved_for(team)
            stage = stage.after(step, objects)
            before = outline
            outline = step.checked_polygon_after(team, outline, reason)
            if (before is None) is not (outline is None):
                reason = f"step {i} ({step.name}) {'untied' if outline is None else 'tied'} it"
            check_blend(steps, i)
        except InputError as error:
            raise error.within(f"mission[{i}].{unresolved.name}") from None
        resolved.append(step)
    return tuple(resolved)


@dataclass(frozen=True)
class ObjectStage:
    """Stage of a hitch with an object, by name, and whether the file specifies its outline."""

    stage: Stage = Stage.FREE
    name: str = ""
    outline_specified: bool = True

    def after(self, step: Step, objects: Mapping[str, SolidObject]) -> ObjectStage:
        """Return the stage after a step; raise InputError if the step is not allowed."""
        name = text("object", self.name if step.object_name is None else step.object_name)
        if name and name not in objects:
            bound = f"one of objects: {', '.join(objects) or 'there are none'}"
            remedy = closest_word(name, [*objects], "add it to objects")
            raise InputError(step.object_key, name, bound, remedy)
        if step.stages is None:
            return self
        begin, end = step.stages
        if self.stage is not begin:
            kinds = "enclose, grasp, lift, carry, set_down, loosen and leave"
            remedy = f"{kinds} an object, in this order"
            found = Circumstance(f"{step.name} needs {begin}, and there is {self.stage}")
            raise InputError("", found, f"{begin}", remedy)
        if begin is not Stage.FREE and name != self.name:
            raise InputError(
                "object", name, f"{self.name}, the one enclosed", "leave that one first"
            )
        if not self.outline_specified and step.moves_points:
            bound = "an outline that the problem states"
            unstated = Circumstance("the problem does not state the outline around the object")
            raise InputError("", unstated, bound, "morph first")
        specified = step.goal_outline is not None
        specified |= self.outline_specified and step.object_name is None
        return ObjectStage(end, "" if end is Stage.FREE else name, specified)


def check_blend(steps: tuple[Step, ...], i: int) -> None:
    """Raise InputError if step i cannot continue into the next one, or has options of its own."""
    step = steps[i]
    following = steps[i + 1 : i + 2]
    if step.blends and not following:
        raise InputError("blend", True, "false in the last step", "omit it: nothing follows")
    if step.blends and following and not following[0].blendable:
        names = ", ".join(kind.name for kind in STEP_KINDS.values() if kind.blendable)
        remedy = f"omit it: only {names} can be blended into one another"
        raise InputError("blend", True, f"false before a {following[0].name}", remedy)
    if step.blends and isinstance(step.settling, float):
        bound = "omitted: steps settle where they stop"
        raise InputError("settle", step.settling, bound, "omit settle or blend")
    is_blended = step.blends or (i > 0 and steps[i - 1].blends)
    for key in ("optimize", "tension") if is_blended else ():
        if vars(step).get(key):
            bound = "omitted: it is not allowed on blended steps"
            raise InputError(key, vars(step)[key], bound, f"omit {key} or blend")
