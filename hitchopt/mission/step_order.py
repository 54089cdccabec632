"""Whether the steps of a mission fit the team, the outlines they meet and one another."""

from __future__ import annotations

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.steps import STEPS, Step


def fitting_steps(team: Team, outline: Outline | None, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Return the steps with their polygons as outlines and their legs as arrays.

    Parameters
    ----------
    team: who flies them.
    outline: the hitch's at the start; None where cables are free.
    steps: with polygons and legs as a user writes them.

    Raises
    ------
    InputError: a step that does not fit the team, the outline it meets, or the next step; its key
        is that of the problem file, from ``mission`` on.
    """
    fitted: list[Step] = []
    for i, given in enumerate(steps):
        try:
            step = given.fitting(team)
            outline = step.polygon_left(team, outline)
            _check_blend(step, steps[i + 1] if i + 1 < len(steps) else None)
            if i > 0 and steps[i - 1].blends:
                _check_untimed(step)
        except InputError as error:
            raise error.within(f"mission[{i}].{given.name}") from None
        fitted.append(step)
    return tuple(fitted)


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
