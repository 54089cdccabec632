"""The film at the head of the README: ``make film`` draws it from the demo's plan."""

from __future__ import annotations

import sys

import numpy as np
from PIL import Image

import hitchopt as ho
from generators.page_pictures import PALETTE, ROUNDS
from generators.problem_collection import ROOT
from hitchopt.view.film import frames
from hitchopt.view.scene import scene_of

FILM = ROOT / "problems" / "pictures" / "carry_box.gif"

SPEED, INTERVAL = 4.0, 0.08
"""How much faster than the flight it is, and the time that a frame is shown [s]."""

REST = 1.2
"""Time for which the last frame is shown [s]."""

SIZE = (800, 450)
"""Width and height [pixels]."""

COLOURED = 8
"""Number of frames whose colours all frames have: flat areas stay as they are between them."""


def main() -> None:
    """Draw the film of the plan in the directory that is named."""
    plan = ho.load(sys.argv[1])
    step = SPEED * INTERVAL
    times = step * np.arange(int(np.ceil(plan.duration / step)) + 1)
    scene = scene_of(plan.motion)
    title = f"{plan.title} ({SPEED:g} × the flight's speed)"
    small = [
        Image.fromarray(frame).resize(SIZE, Image.Resampling.LANCZOS)
        for frame in frames(scene, np.minimum(times, plan.duration), title)
    ]
    sheet = Image.fromarray(np.concatenate(small[:: len(small) // COLOURED]))
    palette = sheet.quantize(PALETTE, kmeans=ROUNDS)
    first, *others = (each.quantize(palette=palette, dither=Image.Dither.NONE) for each in small)
    shown = [1000 * INTERVAL] * len(others) + [1000 * REST]
    first.save(FILM, save_all=True, append_images=others, duration=shown, loop=0, optimize=True)
    sys.stdout.write(f"wrote {FILM}, {FILM.stat().st_size / 1e6:.2f} MB\n")


if __name__ == "__main__":
    main()
