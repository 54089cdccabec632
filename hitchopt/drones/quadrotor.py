"""Quadrotors: models of drones, their masses, thrusts, position loops and measured errors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np

from hitchopt.drones.controllers import (
    CONTROLLERS,
    TRACKING,
    FlightController,
    Gains,
    Pair,
    Tube,
    stiffest_gains,
)
from hitchopt.errors import Circumstance, InputError, OneLine
from hitchopt.values import (
    MAPPING,
    bounded_points,
    check_instance,
    sequence,
    units,
)
from hitchopt.values.fields import (
    FLAGS,
    Key,
    Kind,
    Schema,
    collect,
    documented,
    either,
    join_key,
    list_of,
    mapping_of,
    mapping_schema,
    points,
    record_schema,
    store,
    with_fields,
    words,
)
from hitchopt.values.units import check_lift

GRAVITY = 9.81  # [m/s²] Acceleration of gravity, downward


class Model(NamedTuple):
    """A model of drones."""

    mass: float  # [kg], ready to fly
    max_thrust: float  # [N], of all four motors
    controller: str
    separation: tuple[float, float]  # [m], semi-axes for its size
    cable_density: float  # [kg/m], of cables that suit it
    source: str  # of mass and thrust, as Markdown


CRAZYFLIE = (0.12, 0.30)

MODELS: Mapping[str, Model] = {
    "crazyflie_2.1": Model(
        0.029,
        4 * 0.1125,
        "mellinger",
        CRAZYFLIE,
        0.001,
        source="the firmware's `platform_defaults_cf2.h`, propellers older than 2.1+",
    ),
    "crazyflie_2.1_upgraded": Model(
        0.0325,
        4 * 0.1625,
        "mellinger",
        CRAZYFLIE,
        0.001,
        source="the same, with the thrust upgrade kit",
    ),
    "crazyflie_2.1_brushless": Model(
        0.0393,
        4 * 0.2,
        "mellinger",
        CRAZYFLIE,
        0.0015,
        source="`platform_defaults_cf21bl.h`: guards, 350 mAh battery, Lighthouse deck",
    ),
    # The paper prints neither thrust (here twice the weight) nor size (here a Crazyflie's
    # ellipsoid) nor the weight of its cables (here 10 g/m, a cord)
    "paper_132g": Model(
        0.132,
        2.6,
        "mellinger",
        CRAZYFLIE,
        0.010,
        source="arXiv 2303.07427, section V-B: mass and controller; thrust: twice the weight",
    ),
    "x260_bolt": Model(
        0.32,
        4 * 0.28 * GRAVITY,
        "mellinger",
        (0.25, 0.60),
        0.010,
        source="a frame of 260 mm (`config/models/x260.js` of "
        "[tansa](https://github.com/dennisss/tansa)) with a Crazyflie Bolt",
    ),
}
"""Drones by name, with Mellinger's controller and the stiffest gains.

Those are 4.75 N/m and 1.32 N s/m at 132 g.
"""

LARGEST_DEFAULT = 0.3
"""[kg] Largest mass of drones for which the default ellipsoid, a Crazyflie's, is not questioned."""


def usual_ellipsoid(mass: float) -> tuple[float, float]:
    """Return the semi-axes [m] of drones of a mass [kg] with the proportions of the x260.

    Lengths grow with the cube root of the mass.
    """
    scale = (mass / MODELS["x260_bolt"].mass) ** (1.0 / 3.0)
    radius, height = (float(f"{scale * axis:.2g}") for axis in MODELS["x260_bolt"].separation)
    return radius, height


DEFAULT_TENSION = 0.4  # [N] Default tension without a model
DEFAULT_TILT = 0.25 * np.pi  # [rad] Tilt that limits the horizontal pull of models

TENSION_RATIO = 0.31
"""Default tension of a model over its largest horizontal pull: 0.4 N at 132 g, as without one."""


MAX_TRIM = 2.0  # [m] Largest coordinate of a trim


def _trim(key: str, value: Any) -> Pair:
    """Return a trim [m] as two numbers; InputError for other values."""
    x, y = bounded_points(key, points((2,), "x, y").check(key, value), MAX_TRIM).tolist()
    return x, y


TRIM = replace(points((2,), "x, y", largest=MAX_TRIM), check=_trim, unit="m")
"""Trims in files: [x, y]."""


@documented
@dataclass(frozen=True)
class Quadrotor(OneLine):
    """One kind of quadrotor.

    A ``model`` provides the values that are not specified. ``trim``, ``thrust_factor`` and
    ``tracking`` are measured on single drones; ``hitchopt calibrate`` estimates trims.

    Raises
    ------
    InputError: a number out of its range, an unknown controller, gains without a controller or too
        stiff for it, or values that follow from it.
    """

    mass: Annotated[float, Key(units.MASS, "Mass")] = 0.132
    max_thrust: Annotated[float, Key(units.THRUST, "Largest collective thrust")] = 2.6
    stiffness: Annotated[
        float | None,
        Key(
            units.STIFFNESS,
            "Force of the position loop per offset from its setpoint; null: rigid, or the "
            "controller's",
        ),
    ] = None
    integral: Annotated[
        bool | None,
        Key(
            FLAGS,
            "True if the position loop drives the position error to zero at any force; "
            "null: false, or the controller's",
        ),
    ] = None
    feed_forward: Annotated[
        bool | None,
        Key(
            FLAGS,
            "True if the position loop adds the cable force of the setpoints; null: true, or the "
            "controller's",
        ),
    ] = None
    controller: Annotated[
        str | None,
        Key(
            words(*CONTROLLERS),
            "Flight controller, which determines stiffness, integral and feed_forward; null: none",
        ),
    ] = None
    gains: Annotated[
        Gains | Mapping[str, Any] | None,
        Key(mapping_of(Gains), "Gains of the controller; null: its defaults"),
    ] = None
    latency: Annotated[
        float | None,
        Key(
            units.LATENCY,
            "Delay of motion capture and commands, for which the controller's gains must be low "
            "enough; null: below 0.02",
        ),
    ] = None
    model: Annotated[
        str | None,
        Key(words(*MODELS), "Drone model, which provides the defaults of the other values"),
    ] = None
    trim: Annotated[
        Pair | None,
        Key(
            TRIM,
            "Setpoint minus rest position, [x, y] in the body's frame at yaw 0: not 0 if motion "
            "capture defines the rigid body tilted; null: none",
            omitted=True,
        ),
    ] = None
    thrust_factor: Annotated[
        float | None,
        Key(
            units.THRUST_FACTOR,
            "Commanded thrust over the thrust that it causes; null: 1",
            omitted=True,
        ),
    ] = None
    tracking: Annotated[
        float | Tube | None,
        Key(
            TRACKING,
            "Largest tracking error, a number, or level and height; null: the controller's",
            omitted=True,
        ),
    ] = None

    def __post_init__(self) -> None:
        store(self, **vars(self))
        if self.model is not None:
            values = MODELS[self.model]._asdict()
            for field in fields(self):
                if getattr(self, field.name) == field.default and field.name in values:
                    object.__setattr__(self, field.name, values[field.name])
            if self.gains is None and self.controller == "mellinger":
                store(self, gains=stiffest_gains(self.mass, self.latency))
        check_lift(self.mass, self.max_thrust, GRAVITY)
        if self.controller is None:
            for name in ("gains", "latency"):
                value = getattr(self, name)
                if value is not None:
                    bound = "omitted without a controller"
                    raise InputError(name, value, bound, "name one, or set stiffness")
            return
        for name in ("stiffness", "integral", "feed_forward"):
            value = getattr(self, name)
            if value is not None:
                bound = f"omitted with controller {self.controller}, from which it follows"
                raise InputError(name, value, bound, "omit it, or set gains")
        _loop(self)

    @property
    def loop(self) -> FlightController:
        """The position loop: that of the controller, or one with the specified numbers."""
        return _loop(self)

    @property
    def tube(self) -> Tube | None:
        """Its tracking errors; None without a controller's name and measurements."""
        error = self.loop.tracking if self.tracking is None else self.tracking
        return None if error is None else Tube.of(error)

    @property
    def uncalibrated(self) -> Quadrotor:
        """The kind without the values measured on single drones."""
        return with_fields(self, trim=None, thrust_factor=None, tracking=None)

    def level_pull(self, tilt: float) -> tuple[float, str]:
        """Return the largest horizontal pull [N] at rest within a tilt [rad], and the limit."""
        weight = GRAVITY * self.mass
        by_tilt = weight * math.tan(tilt)
        by_thrust = math.sqrt(max(self.max_thrust**2 - weight**2, 0.0))
        return (by_tilt, "tilt") if by_tilt <= by_thrust else (by_thrust, "thrust")

    @property
    def tension(self) -> float:
        """Default tension [N] of cables; for a model, a fraction of its largest horizontal pull."""
        of_model = float(f"{TENSION_RATIO * self.usual_pull[0]:.2g}")
        return DEFAULT_TENSION if self.model is None else of_model

    @property
    def usual_pull(self) -> tuple[float, str]:
        """Largest horizontal pull [N] up to 45° or the controller's tilt, and its limit's name."""
        return self.level_pull(min(DEFAULT_TILT, self.loop.max_tilt))


@lru_cache(maxsize=1024)
def _loop(kind: Quadrotor) -> FlightController:
    """Return the position loop of a kind of quadrotor."""
    if kind.controller is not None:
        return FlightController.of(kind.controller, kind.mass, kind.gains, kind.latency)
    feed_forward = kind.feed_forward is None or kind.feed_forward
    return FlightController.plain(
        kind.mass, kind.stiffness, integral=bool(kind.integral), feed_forward=feed_forward
    )


MODEL_NAMES = words(**{name: Quadrotor(model=name) for name in MODELS})

QUADROTOR = either(MODEL_NAMES, mapping_of(Quadrotor))
"""Kinds of quadrotors in files: the name of a model, or numbers."""

DRONE_NAME = r"[qrd](0|[1-9][0-9]*)"  # Pattern of drones' names within a team


def _by_drone(key: str, value: Any) -> Quadrotor | dict[str, Quadrotor]:
    """Return the kind of a mapping, or the kinds of the drones that are its keys.

    Its other keys are common to all drones; their kind is that of the empty name.
    """
    kind_of = mapping_of(Quadrotor).check
    named = [name for name in value if re.fullmatch(DRONE_NAME, str(name))]
    if not named:
        kind: Quadrotor = kind_of(key, value)
        return kind
    common = {name: kind for name, kind in value.items() if name not in named}

    def own_kind(name: str) -> tuple[str, Quadrotor]:
        stated = {"model": value[name]} if isinstance(value[name], str) else value[name]
        merged = common | {**stated} if isinstance(stated, Mapping) else stated
        return name, kind_of(join_key(key, name), merged)

    return {"": kind_of(key, common), **dict(collect(own_kind, named))}


def _by_drone_schema(definitions: dict[str, Schema]) -> Schema:
    """Add the schema of kinds by drone to definitions; return a reference to it."""
    kind = record_schema(Quadrotor, definitions)
    kind_or_model = {"anyOf": [kind, MODEL_NAMES.schema]}
    text = "Quadrotors by drone; other keys are common."
    properties = definitions["Quadrotor"]["properties"]
    options = {"patternProperties": {f"^{DRONE_NAME}$": kind_or_model}}
    return mapping_schema("Quadrotors", text, properties, definitions, options)


def quadrotors(min_length: int, max_length: int) -> Kind:
    """Return the kind of a team's quadrotors: one for all, a list, or a mapping by drone."""

    def check(key: str, value: Any) -> Quadrotor | dict[str, Quadrotor]:
        return value if isinstance(value, Quadrotor) else _by_drone(key, value)

    by_drone = Kind((MAPPING,), check, _by_drone_schema)
    return either(MODEL_NAMES, by_drone, list_of(QUADROTOR, min_length, max_length))


QuadrotorOrName = Quadrotor | str
Quadrotors = QuadrotorOrName | Sequence[QuadrotorOrName] | Mapping[str, Any]
"""Kinds of a team: one for all, one per robot or drone, or a mapping by names of drones."""


def kinds_of(
    quadrotor: Quadrotors | None, count: int, owner: str, names: Sequence[str] = ()
) -> tuple[Quadrotor, ...]:
    """Return one kind per owner, or one per drone if those of an owner differ.

    ``quadrotor`` is one for all, one per owner or drone, a mapping by the ``names`` of drones, or
    None for the default kind.
    """
    kind: Any = Quadrotor() if quadrotor is None else quadrotor
    if isinstance(kind, Mapping):
        kind = kind if "" in kind else _by_drone("quadrotor", kind)
    if isinstance(kind, Mapping):
        for name in sorted(kind.keys() - {"", *names}):
            known = ", ".join([*names[:2], "…", *names[-2:]] if len(names) > 4 else names)
            unknown = Circumstance("the team has no such drone")
            raise InputError(f"quadrotor.{name}", unknown, "a drone's name", f"use one of {known}")
        kind = [kind.get(name, kind[""]) for name in names]
    is_common = isinstance(kind, QuadrotorOrName)
    stated = (kind,) * count if is_common else sequence("quadrotor", kind)
    kinds = list[Quadrotor]()
    for index, kind_or_name in enumerate(stated):
        key = "quadrotor" if is_common else f"quadrotor[{index}]"
        is_name = isinstance(kind_or_name, str)
        kinds.append(MODEL_NAMES.check(key, kind_or_name) if is_name else kind_or_name)
        check_instance(f"quadrotor[{index}]", kinds[-1], Quadrotor)
    if len(kinds) == len(names) == 2 * count and kinds[::2] == kinds[1::2]:
        kinds = kinds[::2]
    if len(kinds) not in (count, len(names) or count):
        bound = f"one kind, or a list of {count}"
        raise InputError("quadrotor", len(kinds), bound, f"specify one per {owner}")
    return tuple(kinds)
