"""Settings of a plan file: their types, and texts and names that every reader takes alike."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Sequence
from typing import Any

from .arithmetic import BIG

# Keys of settings and their types: ? nullable, [] list, [2] list of two; keys with * may be absent.
TYPES = {
    "settings": "title:text problem:text request:any groups:group[] others:group[] rules*:rule[]",
    "rule": "name:text unit:text sense:sense limit:number worst:number?",
    "group": "name:text plan:text digest:text records:records",
    "records": "team:any requirements:requirements phases:phase[] assignment:roles?",
    "requirements": "limits:limits separation:separation arena:arena? keep_out:prism[] objects:any",
    "team": "robots:count cable_length:+[] topology:text cable_density:0+ cable_friction:range "
    "tension:+[] quadrotor:kind[] load:0+[] errors*:errors release*:flag",
    "errors": "cable_length:0+ drone:tube? friction:0+",
    "single": "drones:count quadrotor:kind[]",
    "kind": "mass:+ max_thrust:+ stiffness:+? integral:flag? feed_forward:flag? controller:text? "
    "gains:gains? latency:0+? model:text? trim*:number[2] thrust_factor*:+ tracking*:tube",
    "tube": "level:0+ height:0+",
    "gains": "kp:+[2]? kd:+[2]? ki:0+[2]?",
    "limits": "speed:+ acceleration:+ jerk:+ tilt:+ body_rate:+? vertex_speed:+ leg:+ duration:+? "
    "reserve:+ tracking:tube? vertex_error*:+ rest_shift*:+ swing*:+? survive*:text floor*:number?",
    "separation": "radius:+ height:+ cable:0+ crossing:0+ object:0+",
    "arena": "lower:number[3] upper:number[3]",
    "prism": "polygon:number[2][] lower:number upper:number",
    "phase": "name:text step:count start:number end:number remark:text state:text tension:+[2]? "
    "hold:hold?",
    "hold": "object:text by:text cables:count[]",
    "roles": "robots:count[] flipped:flag[]",
    "body": "section:section lower:number upper:number mass:+ friction:0+ at:number[3] yaw:number "
    "rim:rim? fixed:flag",
    "section": "outline:number[2][]? radius:+?",
    "rim": "section:section height:number",
}

SCALARS: dict[str, Callable[[Any], bool]] = {
    "text": lambda x: type(x) is str,
    "flag": lambda x: type(x) is bool,
    "count": lambda x: type(x) is int and 0 <= x < 2**31,
    "number": lambda x: type(x) in (int, float) and abs(x) < BIG,
    "+": lambda x: SCALARS["number"](x) and x > 0,
    "0+": lambda x: SCALARS["number"](x) and x >= 0,
    "range": lambda x: (
        all(SCALARS["0+"](y) for y in x) and len(x) == 2 and x[0] <= x[1]
        if type(x) is list
        else SCALARS["0+"](x)
    ),
    "sense": lambda x: x in ("min", "max"),
    "tube": lambda x: SCALARS["number"](x) and x >= 0,
    "any": lambda _: True,
}


def check_type(key: str, x: Any, form: str) -> None:
    """Raise ValueError with the key of a setting whose value is not of a type of ``TYPES``."""
    if x is None and "?" in form:
        return
    kind = form.rstrip("?")
    item, _, count = kind.rstrip("]").rpartition("[")
    if kind in TYPES and isinstance(x, dict):
        forms = dict(entry.split(":") for entry in TYPES[kind].split())
        absent = {name for name in forms if name[-1] == "*" and name[:-1] not in x}
        forms = {name.strip("*"): form for name, form in forms.items() if name not in absent}
        if forms.keys() != x.keys():
            names = ", ".join(sorted(forms.keys() ^ x.keys()))
            raise ValueError(f"{key} lacks keys, or has unknown ones: {names:.99}")
        for name, child in forms.items():
            check_type(f"{key}.{name}", x[name], child)
    elif item and isinstance(x, list) and count in ("", str(len(x))):
        for i, y in enumerate(x):
            check_type(f"{key}[{i}]", y, item)
    elif kind not in SCALARS or not SCALARS[kind](x):
        raise ValueError(f"{key} is {x!r:.60}, not of the type {form}")


def check_texts(settings: dict[str, Any]) -> None:
    """Raise ValueError for control characters in texts, which terminals may obey.

    The text of the problem may have line breaks and tabs.
    """
    problem = re.sub(r"[\t\n\r\x85]", "", str(settings.get("problem")))
    values: list[Any] = [{**settings, "problem": problem}]
    while values:
        x = values.pop()
        if isinstance(x, dict | list):
            values += [*x, *x.values()] if isinstance(x, dict) else x
        elif isinstance(x, str) and {"Cc", "Cs"} & {*map(unicodedata.category, x)}:
            raise ValueError(f"{x!r:.60} has control characters")


def fold(name: str) -> str:
    """Return a name as readers compare it that ignore case and normalise Unicode."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


def check_members(names: Sequence[str]) -> None:
    """Raise ValueError for names that some reader changes, or takes for one another."""
    words, seen = r"\w[\w.-]*(?<!\.)/", set[str]()
    for name in names:
        if not re.fullmatch(rf"({words})*\w+\.npy", name):
            raise ValueError(f"{name!r:.60} is not the name of an array")
        if fold(name) in seen:
            raise ValueError(f"an array occurs twice, or is easily confused with {name!r:.60}")
        seen.add(fold(name))
