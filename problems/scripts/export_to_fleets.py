"""Export one plan for two autopilots, Crazyswarm2 and PX4, and lint what was written."""

import hitchopt as ho

drone = ho.Quadrotor(mass=0.132, max_thrust=2.6, stiffness=4.75)  # [kg], [N], [N/m]
team = ho.Team(robots=3, cable_length=2.4, quadrotor=drone)
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0)
plan = ho.morph(start, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])

for format in ("crazyswarm2", "mavsdk_drone_show"):
    (export,) = ho.export(plan, format, f"show-{format}")
    (report,) = ho.lint(f"show-{format}")
    error = 1e3 * export.verdict.position.worst
    print(f"{format}: within {error:.3f} mm of the plan for all t, sound: {report.sound}")
    assert error < 2.0
    assert report.sound
