"""A column of buttons in the live view's panel, whose labels change with the plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


class Buttons:
    """Buttons below one another; none is ever removed.

    Pages that draw slowly receive what is added and removed at once, and report updates of what
    is not there as errors.

    Parameters
    ----------
    gui: a viser server's panel.
    place: its tab that they are added to.
    clicked: called with the index of a button that is clicked.
    """

    def __init__(self, gui: Any, place: Any, clicked: Callable[[int], None]) -> None:
        self._gui, self._place, self._clicked = gui, place, clicked
        self._all: list[Any] = []

    def show(self, labels: Sequence[str], colours: Sequence[str | None]) -> None:
        """Show one button a label, in these colours; None is the theme's own."""
        for i, (label, colour) in enumerate(zip(labels, colours, strict=True)):
            if i == len(self._all):
                with self._place:
                    self._all.append(self._gui.add_button(label, color=colour))
                self._all[i].on_click(lambda _, i=i: self._clicked(i))
            button = self._all[i]
            button.label, button.color, button.visible = label, colour, True
        for button in self._all[len(labels) :]:
            button.visible = False

    def paint(self, index: int, colour: str | None) -> None:
        """Draw a button in a colour; None is the theme's own."""
        self._all[index].color = colour

    @property
    def labels(self) -> list[str]:
        """Labels of the buttons that are shown."""
        return [button.label for button in self._all if button.visible]
