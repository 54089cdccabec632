"""Phases as a plan file stores them, read and checked."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from hitchopt.errors import InputError
from hitchopt.motion.phases import CableState, Hold, HoldBy, Phase
from hitchopt.values import finite, positive

EARLIER_STATES = {
    **dict.fromkeys(("parked", "take-off", "land"), CableState.GROUND),
    **dict.fromkeys(("swap 1", "swap 2", "unswap 1", "unswap 2"), CableState.CLASPING),
    **dict.fromkeys(("tighten", "loosen"), CableState.TIGHTENING),
}
"""States of phases without a hitch by their names, for plan files from before states were stored;
all others hang free."""


def read_phase(
    entry: dict[str, Any], robots: int, objects: Collection[str], *, alone: bool
) -> Phase:
    """Return a phase as it is stored; older files have ``formed`` in place of a state.

    Parameters
    ----------
    robots: number of them.
    objects: names of all objects.
    alone: whether the drones carry no cables.
    """
    given = dict(entry)
    formed, state = given.pop("formed", None), given.pop("state", None)
    hold = _hold(given.pop("hold", None), robots, objects)
    phase = Phase(**given)
    for value, kinds, words in (
        (phase.name, {str}, "with a name"),
        (phase.step, {int}, "with a step's index"),
        (phase.remark, {str}, "with a remark in words"),
        (formed, {bool, type(None)}, "formed as true or false"),
    ):
        if type(value) not in kinds:
            raise InputError("phases", value, words, "do not edit them")
    allowed = [each for each in CableState if (each is CableState.NONE) is alone]
    if state is None:
        state = EARLIER_STATES.get(phase.name, CableState.FREE)
        if formed is not False:
            state = CableState.HITCHED
    elif formed is not None or state not in allowed:
        words = f"one of {', '.join(allowed)}, without formed"
        raise InputError("phases.state", state, words, "do not edit them")
    return replace(
        phase,
        start=finite("phases.start", phase.start),
        end=finite("phases.end", phase.end),
        state=CableState(state),
        tension=_tension_range(phase.tension),
        hold=hold,
    )


def _tension_range(given: Any) -> tuple[float, float] | None:
    """Return a phase's range of tensions [N]; None of a phase that states none."""
    if given is None:
        return None
    if isinstance(given, list) and len(given) == 2:
        least, most = (positive("phases.tension", value) for value in given)
        if least <= most:
            return least, most
    raise InputError("phases.tension", given, "[smallest, largest] or null", "do not edit them")


def _hold(entry: dict[str, Any] | None, robots: int, objects: Collection[str]) -> Hold | None:
    """Return what a phase holds, as it is stored."""
    if entry is None:
        return None
    name, cables = entry["object"], entry["cables"]
    if name not in objects or not all(type(k) is int and 0 <= k < robots for k in cables):
        bound = f"an object of {sorted(objects)} and cables from 0 to {robots - 1}"
        raise InputError("phases.hold", entry, bound, "do not edit it")
    return Hold(name, HoldBy(entry["by"]), tuple(cables))
