"""How a step's fields are written in a problem file; read without pydantic, which is slow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from hitchopt.steps.slack_split import SlackSplit
from hitchopt.values import Array

OUTLINE_TEXT = (
    "Vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one more "
    "of the convex arc of an open chain"
)
SHARING_TEXT = "How cables share their slack: balanced, spread, or a list of q-legs d_k [m]"
LEGS_TEXT = f"{SHARING_TEXT}; or that as sharing, with a roll_deg"
DURATION_TEXT = "Exactly that long [s]; without it as fast as the limits allow"
TRIANGLE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]
"""Points [m] of an example."""

REQUIRED = object()
"""Stands for the default of a key that has none."""


@dataclass(frozen=True, eq=False)
class Section:
    """A mapping inside a step.

    Attributes
    ----------
    name, text: of its model, and what it is.
    keys: by name.
    """

    name: str
    text: str
    keys: Mapping[str, Key]


@dataclass(frozen=True, eq=False)
class Key:
    """One key of a problem file.

    Attributes
    ----------
    kind: a name in ``hitchopt.mission.schema.KINDS``, the words allowed, or a section.
    text: what it is, with its unit.
    examples: values that may be written.
    name: in the file, where it is not that of the record's field.
    bounds: further ones of a number, named ``ge``, ``le`` and ``lt``.
    default: the file's, where the record's field does not tell it.
    """

    kind: str | tuple[str, ...] | Section
    text: str
    examples: tuple[object, ...] = ()
    name: str = ""
    bounds: Mapping[str, float] = field(default_factory=dict)
    default: object = REQUIRED


Seconds = Annotated[float | None, Key("Positive", DURATION_TEXT)]
Blend = Annotated[bool, Key("Flag", "Go on into the next step without a stop")]
LegsAtEnd = Annotated[SlackSplit | None, Key("Legs", f"{LEGS_TEXT}, at the step's end")]
By = Annotated[Array | None, Key("Point2", "By how much, [dx, dy] [m]")]
VERTEX = Key("Index", "Which, from 0", (0,))
"""Index of a vertex or an edge."""

OBJECT = Key("Name", "Name of the object", ("box",))
"""Name of an object of the problem."""

MAX_TURNS = 5
"""Most turns of one step: a bounded number of polynomials would not follow more closely."""

YAW = Key(
    "Angle",
    "By how much it turns, counter-clockwise [°]",
    name="yaw_deg",
    bounds={"ge": -360 * MAX_TURNS, "le": 360 * MAX_TURNS},
)
"""Turn of what is carried."""
