"""Problem files of ``hitchopt init``, with sections that list the keys of records."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hitchopt.drones.quadrotor import MODEL_NAMES, MODELS
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.mission.objects import SECTION_KEYS, ObjectKeys
from hitchopt.mission.problem import HITCH_LIMITS, HITCH_SEPARATION, SwarmTeam
from hitchopt.planners.fitting import Range, fitting_lengths, fitting_tensions
from hitchopt.storage.yaml_file import flow, parse_yaml, split_key, with_value
from hitchopt.values import Array, integer
from hitchopt.values.fields import EMPTY, keys_of, with_fields

SECTIONS: dict[str, tuple[type, str, Sequence[str]]] = {
    "team": (Team, "  #", ("cable_density", "tension")),
    "limits": (Limits, "#  ", ()),
    "stated_limits": (Limits, "  #", ("tracking", "swing")),
    "separation": (Separation, "#  ", ()),
    "object": (ObjectKeys, "    #", (*SECTION_KEYS, "rim")),
    "swarm_team": (SwarmTeam, "  #", ()),
    "swarm_limits": (Limits, "#  ", HITCH_LIMITS),
    "swarm_separation": (Separation, "#  ", HITCH_SEPARATION),
}
"""Records by section, with the prefixes of their lines and the fields to exclude."""

COLUMN = 26  # Column of comments
WIDTH = 96  # Maximum length of a line

MIN_ROBOTS = 3  # Smallest number of robots for which problems are written

MAX_ROBOTS = 12
"""Largest number of robots for which problems are written; larger teams need rolled legs."""

TYING_LEG = 3.2
"""Shortest leg of a hitch to be tied, over the radius of drones with their tracking error. With
shorter ones drones come too close as pairs swap or as legs are loosened."""

EDGES = np.linspace(1.0, 2.0, 11) / 0.17
"""Edges of polygons over that radius, in the order of the search: from 1 m for Crazyflies."""

MOVE = 0.27
"""Distance by which two vertices move, and then back as an edge, over the edge: 30 cm for edges of
1.1 m, more than friction at the clasps hides."""

SPARE = 0.15  # [m] Cable length beyond the shortest, and at least within the longest
ROUND = 0.05  # Step of cable lengths [m]
HEIGHT = 0.62  # Altitude over cable length, at which hanging cables clear the ground

NAMES = {3: "a triangle", 4: "a square", 5: "a pentagon", 6: "a hexagon", 8: "an octagon"}


@dataclass(frozen=True)
class FittedProblem:
    """The text of a problem, and what fits its hitch."""

    text: str  # of the problem file
    polygon: str  # in words, such as ``a triangle with edges of 1 m``
    lengths: Range  # shortest and longest cable that fit [m]; infinite without a longest
    tensions: Range  # smallest and largest tension that fit [N]


def for_team(text: str, model: str | None = None, robots: int | None = None) -> FittedProblem:
    """Return the template for a model of drones and a number of robots; None: those that it has.

    Polygons, cables, distances, tension and starts fit the drones with their tracking errors.
    InputError: an unknown model, or a number out of range.
    """
    default: Any = parse_yaml(text)
    model = default["team"]["quadrotor"] if model is None else model
    robots = default["team"]["robots"] if robots is None else robots
    robots = integer("robots", robots, MIN_ROBOTS, MAX_ROBOTS)
    kind: Quadrotor = MODEL_NAMES.check("model", model)
    drone = MODELS[model]
    team = Team(robots, 1.0, quadrotor=kind, cable_density=drone.cable_density)
    separation = Separation(*drone.separation)
    limits = Limits(tracking=default["limits"]["tracking"])
    required = Requirements(limits, separation).flown_by(team).with_reserve
    edge, polygons, lengths = next(_fitting_polygons(team, required))
    length = round(ROUND * math.ceil((lengths.smallest + SPARE) / ROUND), 2)
    sized = replace(team, cable_length=np.full(robots, length))
    tensions = fitting_tensions(polygons, required, sized)
    altitude = round(HEIGHT * length, 1)
    q, r = _starts(robots, length)
    tied, wider = (each.vertices for each in polygons)
    reach = max(np.max(np.abs(wider)) + 0.5 * (length - edge), np.max(np.abs(r)))
    half = math.ceil(reach + 1.0)
    noun = NAMES.get(robots, f"a polygon of {robots}")
    changed: dict[str, Any] = {
        "title": f"Tie {noun}, reshape it, untie it",
        "team.robots": robots,
        "team.cable_length": length,
        "team.cable_density": drone.cable_density,
        "team.tension": kind.tension,
        "team.quadrotor": model,
        "arena": {"lower": [-half, -half, 0], "upper": [half, half, math.ceil(2.0 * altitude)]},
        "start.drones.q": q.tolist(),
        "start.drones.r": r.tolist(),
        "mission[0].form.polygon": tied.tolist(),
        "mission[0].form.altitude": altitude,
        "mission[1].morph.polygon": wider.tolist(),
        "mission[2].move_edge.by": (np.round(tied - wider, 2)[1] + 0.0).tolist(),
    }
    if separation != Separation():
        radius, height = drone.separation
        changed |= {"separation": {"radius": radius, "height": height}}
    for key, value in changed.items():
        text = with_value(text, split_key(key), value)
    text = re.sub(r"^(  \w+: \S+) +#", lambda line: f"{line[1]:<{COLUMN - 2}}  #", text, flags=re.M)
    return FittedProblem(text, f"{noun} with edges of {edge:g} m", lengths, tensions)


def _fitting_polygons(
    team: Team, required: Requirements
) -> Iterator[tuple[float, list[ConvexPolygon], Range]]:
    """Yield edges [m] of regular polygons for which cables fit, the shortest first.

    With each the polygon, the same with an edge moved outward, and the shortest and longest cable
    length [m] of both.
    """
    radius = required.separation.radius
    limits = required.limits
    required = replace(
        required, limits=with_fields(limits, leg=max(limits.leg, TYING_LEG * radius))
    )
    for edge in np.round(EDGES * radius, 1).tolist():
        tied = np.round(regular_polygon(team.robots, edge, 0.5 * math.pi).vertices, 2) + 0.0
        outward = unit(np.mean(tied[[1, 2]], axis=0))
        moves = np.isin(np.arange(len(tied)), [1, 2])[:, None]
        wider = tied + moves * np.round(MOVE * edge * outward, 2)
        polygons = [ConvexPolygon(tied), ConvexPolygon(np.round(wider, 2) + 0.0)]
        lengths = fitting_lengths(polygons, required, team)
        if lengths is not None and lengths.largest >= lengths.smallest + 2.0 * SPARE:
            yield edge, polygons, lengths


def _starts(robots: int, length: float) -> Array:
    """Return starts q and r (2, n, 3) [m] on the ground, in rows, for a cable length [m]."""
    columns = 1 if robots <= 4 else 2
    column, row = np.divmod(np.arange(robots), -(-robots // columns))
    places = np.zeros((2, robots, 3))
    places[..., 0] = length * (column - 0.5 * (columns - 1)) + np.array([[-0.25], [0.25]]) * length
    places[..., 1] = 0.5 * length * (0.5 * np.max(row) - row)
    rounded: Array = np.round(places, 2) + 0.0
    return rounded


def expand_sections(text: str) -> str:
    """Return a template with lines such as ``# (limits)`` replaced by keys."""
    return re.sub(r" *# \((\w+)\)\n", lambda match: _lines(*SECTIONS[match[1]]), text)


def _lines(record: type, prefix: str, exclude: Sequence[str] = ()) -> str:
    """Return comment lines for the keys of a record with a default."""
    lines = list[str]()
    for name, key in keys_of(record).items():
        if key.default is EMPTY or name in exclude:
            continue
        is_nested = key.name == "quadrotor"
        value = "" if is_nested else f" {flow(key.to_file(key.default))}"
        first, *rest = textwrap.wrap(key.described(key.file_kind), WIDTH - COLUMN - 2)
        lines += [f"{prefix} {key.name}:{value}".ljust(COLUMN - 2) + f"  # {first}"]
        lines += [f"{prefix.ljust(COLUMN)}# {line}" for line in rest]
        if is_nested:
            lines += [_lines(Quadrotor, f"{prefix}  ").rstrip("\n")]
    return "\n".join(lines) + "\n"
