"""Carry a crate past a wall: beside it, or over it where it is lifted high enough."""

import hitchopt as ho

crate = ho.SolidObject(
    ho.Section([[-0.07, -0.07], [-0.07, 0.07], [0.07, 0.07], [0.07, -0.07]]), upper=0.3, mass=0.2,
    at=[1.2, 0, 0], rim=ho.Rim(ho.Section(radius=0.3), height=0.25),
)  # fmt: skip
brick = ho.Section([[-0.05, 0.6], [0.05, 0.6], [0.05, -0.6], [-0.05, -0.6]])
wall = ho.SolidObject(brick, upper=0.6, at=[3.4, 0, 0], fixed=True)
team = ho.Team(robots=3, cable_length=2.2, cable_density=0.01, tension=1.0)
start = ho.Hitch.spread(team, [[0.4, 0], [-0.2, -0.35], [-0.2, 0.35]], altitude=1.0)
objects = {"crate": crate, "wall": wall}


def lifted(height: float) -> ho.Plan:
    """Return the plan with a lift of a height [m]."""
    carry = ho.TransportObject("crate", to=[5.5, 0, 0], lift=height)
    return ho.solve(start, carry, objects=objects)


beside, over = lifted(0.3), lifted(0.7)
for where, plan in (("beside", beside), ("over", over)):
    gap = plan.certificate["object_clearance"].worst
    print(f"{where} the wall: {plan.duration:.1f} s, everything keeps {gap:.3f} m from it")
    assert plan.certificate.certified
    assert gap >= 0.035 - 1e-9
assert 10.0 < over.duration < beside.duration
over.save("crate")
