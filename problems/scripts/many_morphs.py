"""Plan a morph with every tension and cable length in parallel; print what limits the others."""

from itertools import product

import hitchopt as ho

START = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]
GOAL = [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]


def main() -> None:
    """Plan and print all cases."""
    cases = [*product([0.3, 0.6, 2.5], [2.2, 2.4])]  # [N], [m]
    teams = [ho.Team(robots=3, cable_length=length, tension=tension) for tension, length in cases]
    starts = [ho.Hitch.spread(team, START, altitude=1.0) for team in teams]
    plans = ho.morphs([(start, GOAL) for start in starts])
    for (tension, length), plan in zip(cases, plans, strict=True):
        if isinstance(plan, ho.InfeasibleError):
            result = f"no plan: {plan.violations[0].constraint}"
        else:
            result = f"{plan.duration:.2f} s"
        print(f"{tension} N, {length} m: {result}")
        assert result.startswith("no plan") == (tension > 1.29)


if __name__ == "__main__":  # other processes import this file
    main()
