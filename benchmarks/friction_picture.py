"""Picture of the benefit of leaning legs against friction: vertex errors with and without it.

Usage: python -m benchmarks.friction_picture [FILE]

The regular triangle of ``benchmarks.flights moved``, flown at μ = 0.1 by the accurate preset: from
a plan that knows the friction, and from one that knows of none.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.flight_plans import moved, planned
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import ACCURATE, Settings

FRICTION = 0.1

FILE = Path(__file__).parent / "results" / "friction.png"


def main() -> None:
    """Simulate both and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, default=FILE)
    given = parser.parse_args()
    draw(given.file)


def draw(file: Path) -> None:
    """Write the picture (PNG)."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), sharey=True, layout="constrained")
    panels = ((0.0, "planned without friction"), (FRICTION, "planned with it: legs lean"))
    for ax, (known, title) in zip(axes, panels, strict=True):
        errors = simulate(
            planned(moved(known)), Settings(preset=ACCURATE, friction=FRICTION)
        ).errors
        for k, color in enumerate(("C3", "C0", "C2")):
            name = f"p{k}, moved outward" if k == 0 else f"p{k}"
            ax.plot(errors.t, 100.0 * errors.errors[:, k], color=color, label=name)
        ax.set(title=title, xlabel="t [s]", xlim=(0.0, float(errors.t[-1])), ylim=(0.0, None))
        ax.grid(visible=True, alpha=0.3)
    axes[0].set_ylabel("vertex to its plan [cm]")
    axes[1].legend(loc="upper left")
    figure.savefig(file, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
