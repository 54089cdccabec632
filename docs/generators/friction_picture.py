"""The picture of friction, known and unknown: ``python -m generators.friction_picture``.

A regular triangle, one of whose vertices moves outward by 0.4 m in 8 s, is flown in the accurate
preset at μ = 0.1: from a plan that knows no friction, and from one that knows it.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

import hitchopt as ho

FILE = Path(__file__).parents[1] / "explanation" / "friction.png"

FRICTION = 0.1


def moved(friction: float) -> ho.Plan:
    """Return the plan of a team whose cables have a friction."""
    team = {"robots": 3, "cable_length": 2.4, "tension": 0.5}
    team |= {"cable_density": 0.01, "cable_friction": friction}
    polygon = ho.regular_polygon(3, 1.3).vertices.tolist()
    hitch = {"polygon": polygon, "altitude": 1.0, "legs": "balanced"}
    step = {"vertex": 0, "by": [0.4, 0.0], "duration": 8.0}
    mission = {"start": {"hitch": hitch}, "mission": [{"move_vertex": step}]}
    return ho.solve(ho.problem_from_dict({"team": team, **mission}))


def draw() -> None:
    """Fly both plans, and draw how far vertices are from their plan."""
    mpl.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), sharey=True, layout="constrained")
    panels = {"planned without friction": 0.0, "planned with it: legs lean": FRICTION}
    for ax, (title, known) in zip(axes, panels.items(), strict=True):
        done = ho.simulate(moved(known), preset="accurate", friction=FRICTION, pull_test=False)
        for k, colour in enumerate(("C3", "C0", "C2")):
            name = f"p{k}, moved outward" if k == 0 else f"p{k}"
            ax.plot(done.errors.t, 100.0 * done.errors.errors[:, k], colour, label=name)
        ax.set(title=title, xlabel="t [s]", xlim=(0.0, done.errors.t[-1]), ylim=(0.0, None))
        ax.grid(visible=True, alpha=0.3)
    axes[0].set_ylabel("vertex to its plan [cm]")
    axes[1].legend(loc="upper left")
    figure.savefig(FILE, dpi=110)


if __name__ == "__main__":
    draw()
