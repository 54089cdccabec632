"""Time the planning and certifying of morphs over the number of robots, and draw it."""

import time

import matplotlib.pyplot as plt

import hitchopt as ho


def seconds(n: int) -> float:
    """Return the processor time [s] to plan and certify a shift of a regular n-gon."""
    polygon = ho.regular_polygon(n, 1.3)
    team, separation = ho.Team(n, cable_length=2.1), ho.Separation(cable=0.03)
    start = ho.Hitch.balanced(team, polygon)
    begin = time.process_time()
    plan = ho.morph(start, polygon.scaled(0.95), separation=separation)
    spent = time.process_time() - begin
    plan.certificate.raise_if_violated()
    return spent


seconds(3)  # the first plan of a process loads libraries
sizes = [3, 4, 6, 8]
times = [seconds(n) for n in sizes]

plt.rcParams.update({"font.size": 8, "pdf.fonttype": 42})  # fonts that publishers take
figure, axes = plt.subplots(figsize=(3.5, 2.5), layout="constrained")  # [inch]
axes.plot(sizes, times, "o-")
axes.set(xlabel="robots", ylabel="processor time [s]", ylim=(0, 1.1 * max(times)))
figure.savefig("benchmark.pdf")
for n, spent in zip(sizes, times, strict=True):
    print(f"{n} robots: {spent:.2f} s")
    assert 0.0 < spent < 60.0
