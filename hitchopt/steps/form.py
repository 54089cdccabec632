"""Form: drones on free cables become a hitch."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.motion.motion import Motion, joined_motions
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.planners.forming.tying_stages import Stage, tied
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import certificate_at_rest, check_at_rest, checked
from hitchopt.steps.edits import SPACE, StepEdit, Tunable, outline_edit
from hitchopt.steps.end_hitch import split_hitch
from hitchopt.steps.free_cables import LEVEL, staged
from hitchopt.steps.keys import LEGS_TEXT, OUTLINE_TEXT, TRIANGLE, Key, Seconds, Section
from hitchopt.steps.route_choice import Route, first_certified
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.slack_split import RolledLegs, SlackSplit
from hitchopt.steps.step import Step
from hitchopt.steps.tying_site import lifted, tying_site
from hitchopt.units import HEIGHT, check_unit
from hitchopt.values import Array, coordinate, instance, text

Assign = Literal["auto", "fixed"]
"""Whether robots are assigned to edges, or robot k takes edge k with its drones as they are."""

SENSES = {"up": 1, "down": -1, "auto": 0}
"""Senses of a swap, as the file has them."""

CABLE_MARGINS = (1.5, 1.25)
"""Times ``separation.cable`` that drones of a formed hitch keep from cables if they can."""

SWAP = Section(
    "SwapKeys",
    "How pairs of drones turn about each other as they form a hitch.",
    {
        "radius": Key(
            "Positive", "Smallest semi-axis of the ellipses [m]", default=SwapSettings.radius
        ),
        "tilt_deg": Key(
            "Angle",
            "Of the axis of turning, upward [°]; without it, chosen",
            bounds={"ge": 0.0, "lt": 90.0},
            default=None,
        ),
        "seconds": Key("Positive", "Half a turn takes at least this long [s]", default=None),
        "sense": Key(
            ("up", "down", "auto"),
            "up: every q goes up first; down; auto: chosen for each vertex",
            default="auto",
        ),
    },
)


@dataclass(frozen=True, eq=False)
class Form(Step):
    """Drones with hanging cables form a hitch.

    All cables are pulled by the team's tension then.

    Parameters
    ----------
    polygon: the hitch's outline, or its points (n, 2) [m] until a Problem knows the topology.
    altitude: of its plane [m].
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for spread, with a margin to the cables
        where drones stand close to them.
    assign: ``auto``: which robot takes which edge, and which end is its q, is chosen.
    swap: how the drones turn about each other.
    duration: of the whole step, exactly that long [s]; None for as fast as the limits allow.
    """

    name: ClassVar[str] = "form"
    summary: ClassVar[str] = "Form the hitch"
    needs_hitch: ClassVar[bool | None] = False
    polygon: Annotated[Outline, Key("Outline", OUTLINE_TEXT, (TRIANGLE,))]
    altitude: Annotated[float, Key("Number", "Height of the hitch's plane [m]")] = 1.0
    legs: Annotated[
        SlackSplit | None, Key("Legs", f"{LEGS_TEXT}, at the step's end; spread without it")
    ] = None
    assign: Annotated[
        Assign,
        Key(("auto", "fixed"), "auto: which robot takes which edge is chosen; fixed: in order"),
    ] = "auto"
    swap: Annotated[SwapSettings, Key(SWAP, SWAP.text)] = field(default_factory=SwapSettings)
    duration: Seconds = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "altitude", coordinate("altitude", self.altitude))
        check_unit("altitude", self.altitude, HEIGHT)
        instance("swap", self.swap, SwapSettings)
        if text("assign", self.assign) not in {"auto", "fixed"}:
            raise InputError("assign", self.assign, "auto or fixed", "write assign: auto")
        super().__post_init__()

    @classmethod
    def from_file(cls, values: dict[str, Any]) -> Self:
        """Return the step with the values of a problem file."""
        swap = dict(values["swap"])
        tilt = swap.pop("tilt_deg")
        sense = SENSES[swap.pop("sense")]
        settings = SwapSettings(
            tilt=None if tilt is None else math.radians(tilt), sense=sense, **swap
        )
        return cls(**values | {"swap": settings})

    def polygon_after(self, team: Team, outline: None) -> Outline:  # noqa: ARG002
        """Return the hitch's outline."""
        return fitting_polygon(team, self.polygon)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from drones on free cables to a hitch."""
        i, requirements, team = task.index, task.requirements, task.before.team
        wanted = self._wanted(team, requirements)
        check_at_rest(wanted, requirements, f"at the end of step {i} (form)")
        site = tying_site(wanted, self.swap, None, requirements)
        stages = tied(site.pre, site.hitch, requirements.limits, self.swap)
        tying = staged(stages, site.hitch, i, requirements)
        if site.pre.shortfall > 0.0:
            checked(tying)  # no use to go there if nothing can be tied
        parts = [_approach(task, site.pre.drones, site.hitch), tying]
        if abs(site.hitch.altitude - wanted.altitude) > LEVEL:
            parts.append(lifted(site.hitch, wanted.altitude, "lower", task))
        senses = np.sign(site.pre.turns.rise)
        after = replace(
            task.before, drones=wanted.drones, hitch=wanted, senses=senses, swap=self.swap
        )
        return StepPlan(self.lasting(task, joined_motions(parts)), after)

    def _wanted(self, team: Team, requirements: Requirements) -> Hitch:
        """Return the hitch to be formed; without ``legs`` a spread one with margins to its cables.

        Where spreading leaves drones less than the first of CABLE_MARGINS times
        ``separation.cable`` from a cable, they get the largest of these that satisfies every limit,
        and are spread beyond that. Drones that stand close lose little of a distance that has
        downwash in it; the one to cables has nothing to spare for a gust as a hitch is drawn tight.
        """
        legs: SlackSplit = "spread" if self.legs is None else self.legs
        spread = split_hitch(team, self.polygon, self.altitude, legs, requirements)
        if self.legs is not None:
            return spread
        cable = requirements.separation.cable
        clearance = certificate_at_rest(spread, requirements)["cable_clearance"].bound
        for margin in CABLE_MARGINS:
            if clearance >= margin * cable:
                break
            separation = replace(requirements.separation, cable=margin * cable)
            wider = replace(requirements, separation=separation)
            same_roll = RolledLegs("spread", spread.roll)
            hitch = split_hitch(team, self.polygon, self.altitude, same_roll, wider)
            if certificate_at_rest(hitch, wider).certified:
                return hitch
        return spread

    def tunables(self) -> Iterator[Tunable]:
        """Yield the duration, and the swap's radius where it is larger than it needs to be."""
        yield from super().tunables()
        if self.swap.radius > SwapSettings.radius:
            lowers = SPACE | {"interlacing", "arena", "crossing"}
            yield Tunable("swap.radius", self.swap.radius, "m", self._with_radius, lowers=lowers)

    def _with_radius(self, radius: float) -> StepEdit:
        return StepEdit("swap.radius", radius, {"swap": replace(self.swap, radius=radius)})

    def scaled(self, factor: float, centre: Array) -> tuple[StepEdit, Array]:  # noqa: ARG002
        """Return the edit that scales the polygon about its centroid, which is the centre then."""
        return outline_edit(self.polygon, factor), self.polygon.centroid


def _approach(task: StepTask, goal: Array, hitch: Hitch) -> Motion:
    """Return the first route to the pre-hitch that the certificate holds for.

    Raises
    ------
    InfeasibleError: none; says what binds on the first of them.
    """
    from hitchopt.planners.forming.approach import DirectApproach, GatheredApproach

    asked = task.before.team, task.before.drones, goal, task.requirements

    def motion_of(stages: list[Stage]) -> Motion:
        return staged(stages, hitch, task.index, task.requirements)

    routes = [Route(planner(*asked), motion_of) for planner in (DirectApproach, GatheredApproach)]
    return first_certified(routes, "no other route to the pre-hitch was found")[0].motion
