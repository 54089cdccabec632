"""What left hitchopt: each name is refused with what to use in its place, all from one table."""

from __future__ import annotations

import re
from collections.abc import Mapping

from hitchopt.errors import Circumstance, InputError

RETIRED: Mapping[str, str] = {
    "tie": "hold objects by three robots or more: form a hitch, enclose and grasp",
    "untie": "loosen and leave the object, then release the hitch",
    "form.by": "omit it: drones swap to tie a hitch",
    "form.order": "omit it: drones swap to tie a hitch",
    "open_vertex": "release the hitch",
    "close_vertex": "form the hitch",
    "simulate --lose": "lose a whole robot (--cut)",
    "check --survivable": "set limits.survive, with which every plan survives the loss of a robot",
    "ho.Tie": "hold objects by three robots or more: ho.Form, ho.Enclose and ho.Grasp",
    "ho.Untie": "use ho.Loosen and ho.Leave, then ho.Release",
    "ho.OpenVertex": "use ho.Release",
    "ho.CloseVertex": "use ho.Form",
    "ho.Feedback": "set team.cable_density, so that plans include the sag, and calibrate the team",
    "simulate --feedback": "set team.cable_density, so that plans include the sag",
    "--perturb vertex_noise": "vertices are no longer measured in flight: omit it",
    "--perturb vertex_delay": "vertices are no longer measured in flight: omit it",
    "simulate --as-calibrated": "state trim and thrust_factor in team.quadrotor, and the drag of "
    "rotors by --perturb rotor_drag=0.012",
    "calibrate --set": "name the plan that was flown by --plan: hovers are not calibrated",
    "calibrate --names": "name the plan that was flown by --plan, with which drones are identified",
    ".svg": "save the outline as GeoJSON, or its points in metres as CSV",
    ".dxf": "save the outline as GeoJSON, or its points in metres as CSV",
    "hitchopt sweep": "loop over problems with ho.solve, or plan many morphs with ho.morphs",
    "init --kind study": "loop over problems with ho.solve, or plan many morphs with ho.morphs",
    "ho.run_sweep": "loop over problems with ho.solve, or plan many morphs with ho.morphs",
    "ho.load_sweep": "loop over problems with ho.solve, or plan many morphs with ho.morphs",
}
"""What to use in place of each name, as users write it.

That is a step ``tie``, a key ``form.by``, a command ``hitchopt sweep``, an option
``simulate --lose``, its value ``init --kind study``, a type of file ``.svg``, or a public name
``ho.Tie``.
"""


def entry_of(name: str) -> str:
    """Return the entry of RETIRED for a name, or for a path that ends with it; empty without one.

    ``mission[0].form.by`` ends with ``form.by``.
    """
    path = re.sub(r"\[\d+\]", "", name)
    return next((each for each in RETIRED if path == each or path.endswith(f".{each}")), "")


def gone(name: str) -> str:
    """Return the sentence that refuses a name that left; empty for any other."""
    entry = entry_of(name)
    return f"`{entry}` is gone; {RETIRED[entry]}" if entry else ""


def refuse_retired(key: str) -> None:
    """Raise InputError if the key of a file, or of a record, left; ``key`` is its path."""
    if entry := entry_of(key):
        raise InputError(key, Circumstance(f"`{entry}` is gone"), "omitted", RETIRED[entry])
