"""Carry a tray by its rim to a table: hold, lift, fly, set down, leave."""

import hitchopt as ho

tray = ho.SolidObject(
    ho.Section(radius=0.1), upper=0.3, mass=0.2, at=[1.2, 0, 0],
    rim=ho.Rim(ho.Section(radius=0.3), height=0.25),
)  # fmt: skip
table = ho.SolidObject(ho.Section(radius=0.4), upper=0.1, at=[0, 1.5, 0], fixed=True)
team = ho.Team(robots=3, cable_length=2.2, cable_density=0.01, tension=1.0)
start = ho.Hitch.spread(team, [[0.4, 0], [-0.2, -0.35], [-0.2, 0.35]], altitude=1.0)

carry = ho.TransportObject("tray", to=[0, 1.5, 0.1])
plan = ho.solve(start, carry, objects={"tray": tray, "table": table}, title="Carry a tray")
plan.save("carried", report=True)

x, y, z = plan.at(plan.duration).object_poses[0, :3]
print(" ".join(phase.name for phase in plan.phases))
print(f"the tray stands at {x:.2f}, {y:.2f}, {z:.2f} m after {plan.duration:.1f} s")
support = plan.certificate["support"].worst
print(f"while it hangs, its weight acts at least {100 * support:.0f} cm within the clasps")
assert [phase.name for phase in plan.phases][:2] == ["enclose", "grasp"]
assert max(abs(x), abs(y - 1.5), abs(z - 0.1)) < 1e-6 < plan.duration
assert support > 0.02
