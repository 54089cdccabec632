"""Compute how errors of cables and drones change tensions and vertices, over the stiffness."""

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4, tension=0.5)
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]])
plan = ho.solve(start, ho.Hold(1.0))

widths = []
for stiffness in (4.75, 10.0, 20.0):  # [N/m] of the drones' position loops
    found = ho.tolerance(plan, [0.5], cable_error=0.01, position_error=0.005, stiffness=stiffness)
    low, high = found.tensions[..., 0].min(), found.tensions[..., 1].max()
    radius = found.radii.max()
    print(f"{stiffness:5.2f} N/m: {low:.2f} to {high:.2f} N, vertices within {100 * radius:.1f} cm")
    assert low < 0.5 < high
    assert 0.0 < radius < 0.2
    widths.append(high - low)
assert widths == sorted(widths)  # stiffer drones turn errors into tension
