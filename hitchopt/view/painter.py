"""A scene as flat polygons, the farthest first: what one direction shows of it.

Cables have pale edges, so that the one that passes over another is told apart in grey as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgba_array
from scipy.spatial.transform import Rotation

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.values import Array
from hitchopt.view.drone_shape import SEGMENTS, Triangles, drone_shape
from hitchopt.view.house_colours import cable_colours, drone_colours, object_colours
from hitchopt.view.object_shape import normals, object_shape, split
from hitchopt.view.scene import Moment, Scene

CASING = 1.8
"""Width of a cable with its pale edges over that without."""

OVERLAP = 0.5
"""Length by which a cable's segments overlap, in its radii: bends have no gaps."""

FRAME, OPEN, PAPER = "#2b2f33", "#ffffff", "#ffffff"

FEWEST = 4
"""Least number of a rotor's corners."""

SPECKS, PALER = 8, 0.5
"""Step from which drones are a pixel or two wide, and the share of white in hollow ones then."""

FLAT = np.array([1.0, 1.0, 0.0])
"""Factors that leave of a direction what is seen."""

SPLITS = 3
"""How often the sides of an object's triangles are halved, so that near and far are told apart."""

LIGHT, DARKEST = unit(np.array([-0.35, -0.55, 1.0])), 0.62
"""Direction toward the light, and the brightness of a face that is turned away from it."""

SHADOW = "#e4e7ea"


@dataclass(frozen=True, eq=False)
class Camera:
    """A direction from which a scene is seen, from far away.

    Attributes
    ----------
    axes: (3, 3), unit vectors to the right, upward, and toward the viewer, in world coordinates.
    """

    axes: Array

    @classmethod
    def toward(cls, azimuth: float, elevation: float) -> Camera:
        """Return the camera that looks from an azimuth and an elevation [deg]."""
        a, e = np.radians([azimuth, elevation])
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return cls(np.stack([right, np.cross(back, right), back]))

    def seen(self, points: Array) -> Array:
        """Return points (…, 3) [m] as right, up and nearness (…, 3) [m]."""
        return np.asarray(points @ self.axes.T)


@dataclass(frozen=True, eq=False)
class Painting:
    """Polygons in the order in which they are painted.

    Attributes
    ----------
    polygons: (m, 4, 2) [m], right and up; a triangle has its last corner twice.
    colours: (m, 4), red, green, blue, opacity.
    """

    polygons: Array
    colours: Array


class Painter:
    """What draws the moments of one scene.

    Parameters
    ----------
    scene: what is drawn.
    camera: from where.
    width: half of a cable's drawn width [m]; None for the scene's.
    size: factor of the drones' drawn sizes.
    step: by which rotors and cables have fewer corners, 1, 2, 4 or SPECKS: few are enough if they
        are small. Of drones that are SPECKS only the rotors are drawn, hollow ones paler.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        width: float | None = None,
        size: float = 1.0,
        step: int = 1,
    ) -> None:
        team: Team = scene.motion.team
        self.camera, self.floor = camera, scene.motion.requirements.floor
        self.width = scene.radius if width is None else width
        self.cables = to_rgba_array(cable_colours(team.robots))
        self.step = step
        radius = size * scene.motion.requirements.separation.radius
        shape = drone_shape(radius, max(FEWEST, SEGMENTS // self.step))
        own, specks = to_rgba_array(drone_colours(team)), step >= SPECKS
        hollow = np.array([name[0] == "r" for name in team.drone_names])
        open_fills = PALER * to_rgba_array(OPEN) + (1.0 - PALER) * own
        fills = np.where(hollow[:, None], open_fills if specks else to_rgba_array(OPEN), own)
        frame = np.broadcast_to(to_rgba_array(FRAME), own.shape)
        bodies = scene.motion.requirements.objects.values()
        self.objects = [split(_corners(object_shape(body)), SPLITS) for body in bodies]
        # Objects stand on tables, and lie on cables, which are drawn thicker than they are.
        self.backs = [
            body.circumradius / 2**SPLITS if body.fixed else -2.0 * self.width for body in bodies
        ]
        self.fills = to_rgba_array(object_colours(scene.motion))
        rotors = (shape.rotors, fills, False)
        whole = (shape.frame, frame, True), rotors, (shape.rims, own, False)
        self.parts = (rotors,) if specks else whole

    def painted(self, moment: Moment) -> Painting:
        """Return a moment: shadows on the ground, then everything else, the farthest first."""
        turns = Rotation.from_quat(moment.quaternions, scalar_first=True).as_matrix()
        layers = []
        for part, shades, solid in self.parts:
            corners = np.einsum("dij,vj->dvi", turns, part.vertices) + moment.drones[:, None]
            quads = self.camera.seen(corners)[:, part.quads].reshape(-1, 4, 3)
            colours = np.repeat(shades, len(part.quads), axis=0)
            if solid:
                shown = normals(quads)[:, 2] > 0.0
                quads, colours = quads[shown], colours[shown]
            layers.append((quads, colours, 0.0))
        layers += self._objects(moment)
        cables = moment.cables[:, :: self.step]
        shades = np.repeat(self.cables, cables.shape[1] - 1, axis=0)
        casing = np.broadcast_to(to_rgba_array(PAPER), shades.shape)
        for width, longer, colour, back in (
            (CASING * self.width, 0.0, casing, self.width),
            (self.width, OVERLAP * self.width, shades, 0.0),
        ):
            layers.append((self._strips(cables, width, longer), colour, back))
        polygons, colours, nearness = (
            np.concatenate(column)
            for column in zip(
                *(
                    (quads, shade, np.mean(quads[..., 2], axis=1) - back)
                    for quads, shade, back in layers
                ),
                strict=True,
            )
        )
        order = np.argsort(nearness, kind="stable")
        ground = cables.copy()
        ground[..., 2] = self.floor
        shadows = self._strips(ground, self.width, 0.0)
        dark = np.broadcast_to(to_rgba_array(SHADOW), (len(shadows), 4))
        return Painting(
            np.concatenate([shadows, polygons[order]])[..., :2],
            np.concatenate([dark, colours[order]]),
        )

    def _objects(self, moment: Moment) -> list[tuple[Array, Array, float]]:
        """Return the faces of objects that are seen, lit from above."""
        layers = []
        placed = zip(self.objects, moment.objects, self.fills, self.backs, strict=True)
        for corners, pose, fill, back in placed:
            turn = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
            there = corners @ turn.T + pose[:3]
            outward = normals(there)
            shown = outward @ self.camera.axes[2] > 0.0
            bright = DARKEST + (1.0 - DARKEST) * np.maximum(outward[shown] @ LIGHT, 0.0)
            shades = np.tile(fill, (len(bright), 1))
            shades[:, :3] *= bright[:, None]
            layers.append((self.camera.seen(there[shown])[:, [0, 1, 2, 2]], shades, back))
        return layers

    def _strips(self, curves: Array, width: float, longer: float) -> Array:
        """Return the segments of curves (n, points, 3) as seen quadrangles (m, 4, 3) [m].

        Parameters
        ----------
        curves: (n, points, 3) [m]
        width: half of a segment's width [m].
        longer: what a segment is longer by at either end [m].
        """
        seen = self.camera.seen(curves)
        first, last = seen[:, :-1].reshape(-1, 3), seen[:, 1:].reshape(-1, 3)
        along = unit((last - first) * FLAT)
        aside = width * np.stack([-along[:, 1], along[:, 0], np.zeros(len(along))], axis=-1)
        first, last = first - longer * along, last + longer * along
        return np.stack([first - aside, first + aside, last + aside, last - aside], axis=1)


def _corners(mesh: Triangles) -> Array:
    """Return the corners (m, 3, 3) [m] of a mesh's triangles."""
    return np.asarray(mesh.vertices[mesh.faces])
