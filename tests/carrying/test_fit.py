"""Fits of hitches to objects: clearances, capacities, refusals, files and the command."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

import hitchopt as ho
from hitchopt.carrying.holding import Capacity, Grip
from hitchopt.carrying.polygons import rest_polygons
from hitchopt.cli import main
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import Rim
from hitchopt.planners.fitting import (
    enclosing_polygon,
    fitting_lengths,
    fitting_tensions,
    shortest_cable,
)

BOX = ho.Section([[0.2, 0.15], [0.2, -0.15], [-0.2, -0.15], [-0.2, 0.15]])
DISC = ho.Section(radius=0.3)
ODD = ho.Section([[0.4, 0.3], [0.2, 0.0], [-0.1, 0.05], [-0.15, 0.4], [0.2, 0.45]])


def random_section(seed: int) -> ho.Section:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-1.0, 0.5) * np.array([1.0, rng.uniform(0.4, 1.0)])
    points = rng.normal(size=(8, 2)) * scale + rng.uniform(-3.0, 3.0, 2)
    return ho.Section(points[ConvexHull(points).vertices])


@pytest.mark.parametrize("section", [BOX, DISC, ODD, *map(random_section, range(2))])
@pytest.mark.parametrize("n", [3, 4, 5])
def test_enclosing_polygons_keep_the_clearance(section: ho.Section, n: int) -> None:
    polygon = enclosing_polygon(section, n, 0.04)
    p, u = polygon.vertices, polygon.edge_directions
    outward = np.column_stack([-u[:, 1], u[:, 0]])
    gaps = np.sum(p * outward, axis=1) - section.support(outward)
    np.testing.assert_allclose(gaps, 0.04, atol=1e-9)  # lines through the edges
    distances = section.segment_distance(p, np.roll(p, -1, axis=0))
    assert np.min(distances) >= 0.04 - 1e-9  # edges between their ends
    assert np.min(polygon.edge_lengths) >= 0.5 * np.mean(polygon.edge_lengths) - 1e-9
    assert len(polygon) == n
    assert np.min(polygon.exterior_angles) >= 0.6 * 2.0 * math.pi / n - 1e-9


def test_a_box_is_enclosed_by_a_rectangle_and_a_disc_by_regular_polygons() -> None:
    rectangle = enclosing_polygon(BOX, 4, 0.035)
    np.testing.assert_allclose(np.sort(rectangle.edge_lengths), [0.37, 0.37, 0.47, 0.47])
    for n in (3, 5, 6):
        edges = enclosing_polygon(DISC, n, 0.035).edge_lengths
        np.testing.assert_allclose(edges, 2.0 * 0.335 * math.tan(math.pi / n))
    narrow = ho.Section([[0.0, 0.0], [1.0, 0.0], [1.0, 0.05], [0.0, 0.05]])
    with pytest.raises(ho.InfeasibleError, match="too narrow for so many edges"):
        enclosing_polygon(narrow, 7, 0.035)


def test_cables_are_long_enough_for_the_enclosing_polygon() -> None:
    holding = ho.fit(ho.Section(radius=0.2), 3, tension=1.0, compared=()).holding
    assert holding.enclosing is not None
    drum = ho.SolidObject(ho.Section(radius=0.2), 0.0, 0.3, 0.03, at=[2.0, 1.0, 0.0])
    team = ho.Team(3, holding.cable_length, tension=1.0)
    start = ho.Hitch.spread(team, 1.2 * holding.enclosing.vertices + [2.0, 1.0], 1.2)
    steps = [ho.Enclose("drum"), ho.Grasp("drum", by="grip")]
    plan = ho.solve(start, steps, objects={"drum": drum})
    assert plan.certificate.certified


def test_the_shortest_cable_keeps_drones_apart() -> None:
    polygon, separations = enclosing_polygon(DISC, 3, 0.035), []
    cable = shortest_cable([polygon], Requirements())
    for length in (cable - 0.01, cable):
        drones = ho.Hitch.balanced(ho.Team(3, length), polygon).drones * ho.Separation().scale
        separations.append(float(np.min(pdist(drones))))
    assert separations[0] < 1.5 <= separations[1] + 1e-6


def clearances(hitch: ho.Hitch) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the distances [m] of drones to all straight cable parts but their own legs."""
    nodes, parts = np.vstack([hitch.vertices, hitch.drones]), hitch.team.layout.part_nodes
    drones = len(hitch.vertices) + np.arange(hitch.team.drones)
    base, along = nodes[parts[:, 0]], np.diff(nodes[parts], axis=1)[:, 0]
    offset = nodes[drones][:, None] - base
    share = np.clip(np.sum(offset * along, axis=-1) / np.sum(along**2, axis=-1), 0.0, 1.0)
    distances = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    own = np.any(parts[None] == drones[:, None, None], axis=-1)
    return np.where(own, np.inf, distances)


@pytest.mark.parametrize("n", [3, 5, 8])
def test_lengths_and_tensions_that_fit_keep_all_distances(n: int) -> None:
    """At the ends of their ranges, and no longer beyond them; of light cables and of heavy ones."""
    polygon, requirements = ho.regular_polygon(n, 1.3), Requirements(ho.Limits(leg=0.3))
    for density in (0.0, 0.01):
        team = ho.Team(n, 2.0, cable_density=density, tension=0.5)
        shortest, longest = fitting_lengths([polygon], requirements, team) or (0.0, 0.0)

        def keeps(cable: float, tension: float, density: float = density) -> bool:
            try:
                sized = ho.Team(n, cable, cable_density=density, tension=tension)
                hitch = ho.Hitch.balanced(sized, polygon)
            except ho.InfeasibleError:
                return False
            apart = np.min(pdist(hitch.drones * ho.Separation().scale)) >= 1.0
            clear = np.min(clearances(hitch)) >= ho.Separation().cable
            return bool(np.min(hitch.q_legs) >= 0.3 and apart and clear)

        assert keeps(shortest, 0.5)
        assert not keeps(shortest - 0.1, 0.5)
        if math.isfinite(longest):
            assert keeps(longest, 0.5)
            assert not keeps(longest + 0.1, 0.5)
        assert math.isfinite(longest) == (n == 8)
        sized = ho.Team(n, shortest + 0.1, cable_density=density)
        weakest, largest = fitting_tensions([polygon], requirements, sized)
        assert largest == pytest.approx(9.81 * 0.132)
        if density:
            assert keeps(shortest + 0.1, 0.5 * weakest)  # with a factor of two for safety
            assert not keeps(shortest + 0.1, 0.4 * weakest)
        else:
            assert weakest == 0.0


@pytest.mark.slow
def test_resting_loads_are_limited_by_clasps_and_thrust() -> None:

    def capacity(max_thrust: float) -> Capacity:
        kind = ho.Quadrotor(max_thrust=max_thrust)
        options: dict[str, Any] = {"cable_length": 1.4, "tension": 1.0, "compared": ()}
        return ho.fit(0.3, 4, quadrotor=kind, height=0.2, **options).holding.rest_capacity

    weak, strong = map(capacity, (1.9, 5.0))
    assert weak.binding == "thrust"
    assert weak.mass < strong.mass < 2.0 * 4 * 1.0 * math.cos(math.pi / 4) / 9.81  # clasps close


@pytest.mark.parametrize(("n", "cable"), [(3, 1.8), pytest.param(4, 1.4, marks=pytest.mark.slow)])
def test_a_round_rim_bears_what_pulls_at_its_clasps_close(n: int, cable: float) -> None:
    """Two legs and two edges of one tension T bear 2 T cos(π/n) at a clasp, with cables."""
    kind = ho.Quadrotor(max_thrust=5.0)
    options: dict[str, Any] = {"cable_length": cable, "tension": 1.0, "compared": ()}
    holding = ho.fit(0.3, n, quadrotor=kind, height=0.2, **options).holding
    assert isinstance(holding.rest, ho.ConvexPolygon)
    edges = holding.rest.edge_lengths
    cables = 0.005 * np.sum(edges)  # legs bear their own weight
    bound = 2.0 * n * math.cos(math.pi / n) / 9.81 - cables
    assert holding.rest_capacity.binding == "load"
    assert 0.98 * bound < holding.rest_capacity.mass <= bound


def test_fit_of_a_cylinder() -> None:
    limits = ho.Limits(tilt=math.radians(60.0))
    fit = ho.fit(0.2, 3, tension=1.3, limits=limits, compared=(3, 4))
    assert fit.notes[0] == "outline: circle of radius 0.2 m"
    grips = fit.capacities("grip")
    best = grips[3]
    assert best.mass > 0.1
    assert isinstance(fit.holding.grip, Grip)
    assert best.binding == "grip"
    slip_load = float(fit.holding.grip.slip_load(0.5))
    assert 1.5 * 9.81 * best.mass == pytest.approx(slip_load, rel=0.03)
    assert best.mass == max(each.mass for each in grips.values())
    assert fit.holding.cable_length == pytest.approx(1.6, abs=0.1)
    fit.raise_if_too_heavy(0.1)
    with pytest.raises(ho.InfeasibleError, match=r"^grip: 0\.2 kg is above"):
        fit.raise_if_too_heavy(0.2)


@pytest.mark.slow
def test_a_concave_outline_is_held_by_its_hull() -> None:
    fit = ho.fit([[0, 0], [0.4, 0], [0.4, 0.3], [0.2, 0.1], [0, 0.3]], 3, cable_length=1.8)
    assert fit.notes[0] == "outline: 0.4 x 0.3 m, 5 corners"
    assert any("concave" in note for note in fit.notes)
    assert len(fit.section.core) == 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": 1}, "robots = 1"),
        ({"compared": [2]}, "compared = 2"),
        ({"tension": -1.0}, "tension = -1"),
        ({"clearance": -0.1}, "clearance = -0.1"),
        ({"outline": [[0, 0], [1, 1], [2, 2]]}, "outline"),
        ({"outline": "part.step"}, "a drawing"),
        ({"tension": 1.3}, r"tilt: 1.3 N .*raise limits.tilt_deg"),
        ({"cable_length": 1.0}, r"edge \d.*use cables of 1\.27 m"),
        pytest.param(
            {"outline": 0.01, "robots": 8, "tension": 1.0},
            "no cable length",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_invalid_or_infeasible_fits_are_refused(options: dict[str, Any], words: str) -> None:
    defaults: dict[str, Any] = {"outline": 0.2, "robots": 3, "compared": ()}
    with pytest.raises((ho.InputError, ho.InfeasibleError), match=words):
        ho.fit(**(defaults | options))


@pytest.mark.slow
def test_the_command_writes_files_and_exits_with_3_if_the_mass_is_too_large(
    tmp_path: Path,
) -> None:
    arguments = ["fit", "circle:0.2", "--robots", "3", "-o", str(tmp_path / "out"), "--mass"]
    result = CliRunner().invoke(main, [*arguments, "0.05"])
    assert result.exit_code == 0, result.output
    assert "50 g is held by grip" in result.output
    content = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert content["format"] == "hitchopt-fit/1"
    assert len(content["enclosing"]) == len(content["grip"]["polygon"]) == 3
    assert content["largest_mass"]["grip"]["3"]["mass"] > 0.05
    assert (tmp_path / "out" / "fit.png").read_bytes()[:4] == b"\x89PNG"
    paper = ["--width", "3.5"]
    assert "and fit.pdf are in" in CliRunner().invoke(main, [*arguments, "0.05", *paper]).output
    written = (tmp_path / "out" / "fit.pdf").read_bytes()
    assert b"/CIDFontType2" in written  # TrueType, as publishers ask for
    assert b"/Type3" not in written
    assert CliRunner().invoke(main, [*arguments, "0.5", "--by", "rest"]).exit_code == 3
    for outline in ("circle:a", "[[0, 0", "none.csv"):
        assert CliRunner().invoke(main, ["fit", outline, "--robots", "3"]).exit_code == 2


@pytest.mark.parametrize(("stem", "fits"), [(0.05, True), (0.14, False)])
def test_edges_of_polygons_below_a_rim_keep_off_the_stem(stem: float, *, fits: bool) -> None:
    """Where no triangle is left, the limit is named."""
    tray = ho.SolidObject(ho.Section(radius=stem), 0.0, 0.35, rim=Rim(BOX, 0.3))
    if not fits:
        with pytest.raises(ho.InfeasibleError, match=r"support: .* widen the rim"):
            rest_polygons("tray", tray, 3, 0.08)
        return
    for polygons in rest_polygons("tray", tray, 3, 0.08):
        corners = polygons.clasps
        along = np.roll(corners, -1, axis=0) - corners
        inward = along[:, ::-1] * [1.0, -1.0] / np.linalg.norm(along, axis=1)[:, None]
        assert np.min(-np.sum(corners * inward, axis=1)) >= stem + 0.01


@pytest.mark.slow
def test_edges_of_a_resting_polygon_keep_off_the_stem_below_the_rim() -> None:
    """Where no triangle is left, the limit is named."""
    rest = ho.fit(BOX, 3, stem=0.05, tension=1.0, compared=()).holding.rest
    assert isinstance(rest, ho.ConvexPolygon)
    u = rest.edge_directions
    offsets = np.sum(rest.vertices * np.column_stack([-u[:, 1], u[:, 0]]), axis=1)
    assert np.min(offsets) >= 0.05 + 0.01
    refused = ho.fit(BOX, 3, stem=0.14, tension=1.0, compared=()).holding.rest
    assert isinstance(refused, ho.InfeasibleError)
    assert refused.violations[0].constraint == "support"


@pytest.mark.slow
def test_the_enclosing_polygon_is_the_one_that_enclose_takes() -> None:
    fitted = ho.fit(BOX, 4, tension=1.0, limits=ho.Limits(tilt=math.radians(60)), compared=())
    assert fitted.enclosing is not None
    holding = fitted.holding
    box = ho.SolidObject(BOX, 0.0, 0.3, 0.05, at=[1.0, 0.0, 0.0])
    team = ho.Team(4, holding.cable_length, tension=1.0, cable_friction=0.15)
    start = ho.Hitch.spread(team, fitted.enclosing.vertices + [1.0, 0.0], 1.2)
    plan = ho.solve(start, ho.Enclose("box"), objects={"box": box})
    end = plan.motion.vertices.at(plan.duration)[:, :2] - [1.0, 0.0]
    np.testing.assert_allclose(end, fitted.enclosing.vertices, atol=0.01)
