"""Morph with custom costs: a drone near a camera, vertices near a line, even legs."""

import casadi as ca
import numpy as np

import hitchopt as ho

team = ho.Team(robots=4, cable_length=2.4)
square = ho.regular_polygon(4, 1.2)
start = ho.Hitch(team, square, 1.0, [0.4, 0.8, 0.4, 0.8])
goal, s = square.translated([1.0, 0.0]), np.linspace(0, 1, 101)
costs = {
    "camera": lambda out, _: ca.sumsqr(out["positions"][:3] - ca.DM([0.5, 1.5, 1.0])),
    "line": lambda out, _: 5 * (ca.sum1(out["vertices"][1::3]) / 4 - 0.3) ** 2,
    "legs": lambda out, _: 5 * ca.sumsqr(out["legs"][::2] - out["legs"][1::2]),
}
plain = ho.route(start, goal)
routes = {name: ho.route(start, goal, cost=cost) for name, cost in costs.items()}
for name, path in routes.items():
    distances = []  # from the camera, from the line, and between legs [m]
    for each in (plain, path):
        shapes, camera = each.shapes(s), np.array([0.5, 1.5, 1.0])
        to_camera = np.linalg.norm(each.drones(s)[:, 0] - camera, axis=1)
        to_line = np.abs(shapes.polygons[..., 1].mean(axis=1) - 0.3)
        uneven = np.abs(np.diff(shapes.legs, axis=2))
        distances.append({"camera": to_camera, "line": to_line, "legs": uneven}[name].mean())
    motion, (without, with_cost) = ho.time(path), distances
    print(f"{name}: {without:.2f} m without, {with_cost:.2f} m with it, {motion.duration:.2f} s")
    assert with_cost < 0.9 * without, name
    assert motion.duration > ho.time(plain).duration
    assert ho.certify(motion).certified
