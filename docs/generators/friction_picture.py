"""The picture of planning with and without friction: ``python -m generators.friction_picture``.

In the accurate preset, at μ = 0.1, a vertex of a regular triangle moves outward by 0.4 m in 8 s:
with a plan for no friction, and with a plan for the actual friction.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

import hitchopt as ho

FILE = Path(__file__).parents[1] / "explanation" / "friction.png"

FRICTION = 0.1


def moved_vertex_plan(friction: float) -> ho.Plan:
    """Return the plan for a cable friction."""
    team = {"robots": 3, "cable_length": 2.4, "tension": 0.5}
    team |= {"cable_density": 0.01, "cable_friction": friction}
    polygon = ho.regular_polygon(3, 1.3).vertices.tolist()
    hitch = {"polygon": polygon, "altitude": 1.0, "legs": "balanced"}
    step = {"vertex": 0, "by": [0.4, 0.0], "duration": 8.0, "settle": False}
    mission = {"start": {"hitch": hitch}, "mission": [{"move_vertex": step}]}
    return ho.solve(ho.problem_from_dict({"team": team, **mission}))


def draw() -> None:
    """Fly both plans, and draw the errors of the vertices."""
    mpl.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), sharey=True, layout="constrained")
    panels = {"planned without friction": 0.0, "planned with it: legs lean": FRICTION}
    for ax, (title, planned) in zip(axes, panels.items(), strict=True):
        plan = moved_vertex_plan(planned)
        simulation = ho.simulate(plan, preset="accurate", friction=FRICTION, pull_test=False)
        for k, colour in enumerate(("C3", "C0", "C2")):
            name = f"p{k}, moved outward" if k == 0 else f"p{k}"
            ax.plot(simulation.errors.t, 100.0 * simulation.errors.errors[:, k], colour, label=name)
        ax.set(title=title, xlabel="t [s]", xlim=(0.0, simulation.errors.t[-1]), ylim=(0.0, None))
        ax.grid(visible=True, alpha=0.3)
    axes[0].set_ylabel("vertex to its plan [cm]")
    axes[1].legend(loc="upper left")
    figure.savefig(FILE, dpi=110)


if __name__ == "__main__":
    draw()
