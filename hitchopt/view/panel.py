"""The live view's panel for editing by hand, and the handles in its scene."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.steps import STEP_KINDS
from hitchopt.steps.step import Edit
from hitchopt.storage.yaml_file import Plain, flow, parse_yaml, split_key, value_at
from hitchopt.values.fields import keys_of
from hitchopt.view.editing import START, Editing, Handle, Stage, Status, step_key
from hitchopt.view.live import LiveView, plain_words
from hitchopt.view.style import MARK_COLOUR

# Radius of a handle, and length of the arrows of the one that is chosen [m]
SIZE, REACH = 0.04, 0.35
# Colours of the handle that is chosen, and of the others, as red, green and blue
CHOSEN_COLOUR, IDLE_COLOUR = tuple(bytes.fromhex(MARK_COLOUR[1:])), (90, 96, 102)
# Number of handles of a step up to which all are drawn, while a list has all of them; and
# decimals of the distance that one is dragged by [m]: nobody drags more finely
MOST, DECIMALS = 80, 4


class EditingPanel:
    """Edits a problem in the live view, which shows its plan."""

    def __init__(self, live: LiveView, editing: Editing) -> None:
        self.live, self.editing = live, editing
        self.step, self.handle = START, ""
        self._lock = threading.RLock()
        self._shown, self._built = editing.planned, ""
        self._parts: list[Any] = []
        self._buttons: list[Any] = []
        self._offered: tuple[Any, ...] = ()
        gui = live.server.gui
        self._tab = live.panel.add_tab("Edit")
        with self._tab:
            self.status = gui.add_markdown("")
            self.reply = gui.add_markdown("", visible=False)
            group = gui.add_button_group("file", ("Undo", "Redo", "Save"))
            group.on_click(lambda event: self._do(self._filed, event.target.value))
        self._build()
        self._tell(editing.status)
        editing.listener = self.refresh

    def refresh(self) -> None:
        """Show the text, status and plan of the editing."""
        with self._lock:
            text, status, planned = self.editing.now()
            if planned is not self._shown:
                self._shown = planned
                title = self.editing.problem.title
                self.live.show_plan(planned.motion, planned.certificate, title)
            if text != self._built:
                self._build()
            self._tell(status)

    def choose(self, step: int, handle: str = "") -> None:
        """Show a step, or the start, at its end, and one of its handles."""
        with self._lock:
            if step != self.step:
                ends = [p.end for p in self._shown.motion.phases if p.step == step]
                self.live.seek(max(ends, default=0.0))
            self.step, self.handle = step, handle
            self._build()

    def _tell(self, status: Status) -> None:
        """Show how the plan relates to the problem, and the suggestions."""
        self.live.note("" if status.stage is Stage.CURRENT else str(status.stage))
        disk = "saved" if self.editing.saved else "not saved"
        words = f"**{plain_words(str(status.stage))}** ({disk})"
        if status.suggestions:
            words += "  \nA click below makes a suggested change."
        if status.words:
            words += "  \n" + "  \n".join(map(plain_words, status.words.splitlines()))
        self.status.content = words
        if status.suggestions != self._offered:
            self._offered = status.suggestions
            for button in self._buttons:
                button.remove()
            with self._tab:
                self._buttons = [
                    self._button(str(x.change), self.editing.put, *x.change.edits, hint=str(x))
                    for x in status.suggestions
                ]

    def _build(self) -> None:
        """Build the parts that depend on the text and the step."""
        for part in self._parts:
            part.remove()
        self._built = self.editing.text
        data, count = parse_yaml(self._built), len(self.editing.problem.mission)
        self.step = min(self.step, count - 1)
        by_name = self.editing.handles(self.step)
        if self.handle not in by_name:
            self.handle = next(iter(by_name), "")
        with self._tab:
            folder = self.live.server.gui.add_folder("Step")
            with folder:
                self._add_steps(data, count)
                self._add_values(data, by_name)
        few = by_name.values() if len(by_name) <= MOST else ()
        self._parts = [folder, *map(self._ball, few)]
        if self.handle:
            self._parts.append(self._gizmo(by_name[self.handle]))

    def _add_steps(self, data: Plain, count: int) -> None:
        gui = self.live.server.gui
        names = [step_key(data, i) for i in range(START, count)]
        steps = gui.add_dropdown("step", names, initial_value=names[self.step - START])
        steps.on_update(
            lambda event: self._do(self.choose, names.index(event.target.value) + START)
        )
        kinds = gui.add_dropdown("new step", tuple(STEP_KINDS), initial_value="hold")
        self._button("Add after this step", lambda: self._added(kinds.value))
        if self.step != START:
            group = gui.add_button_group("this step", ("Earlier", "Later", "Remove"))
            group.on_click(lambda event: self._do(self._rearranged, event.target.value))

    def _add_values(self, data: Plain, by_name: dict[str, Handle]) -> None:
        gui, key = self.live.server.gui, step_key(data, self.step)
        place = None
        if by_name:
            chosen = gui.add_dropdown("handle", tuple(by_name), initial_value=self.handle)
            chosen.on_update(lambda event: self._do(self.choose, self.step, event.target.value))
            here = tuple(map(float, by_name[self.handle].place))
            place = gui.add_vector3("x, y, z [m]", here, step=0.05)
        given = value_at(data, split_key(key))
        kind = STEP_KINDS.get(key.rpartition(".")[2]) if self.step != START else None
        known = given if kind is None else [key.name for key in keys_of(kind).values()]
        typed = {name: flow(given[name]) if name in given else "" for name in known}
        fields = {name: gui.add_text(name, value) for name, value in typed.items()}

        def plan() -> None:
            edits = [
                Edit(f"{key}.{name}", parse_yaml(field.value or "null", name))
                for name, field in fields.items()
                if field.value != typed[name]
            ]
            if edits:
                self.editing.put(*edits)
            elif place is not None:
                self._dropped(by_name[self.handle], place.value)

        self._button("Plan with these values", plan)

    def _added(self, kind: str) -> None:
        self.editing.add(self.step, kind)
        self.choose(self.step + 1)

    def _rearranged(self, how: str) -> None:
        if how == "Remove":
            self.editing.remove(self.step)
            return
        to = self.step + (1 if how == "Later" else -1)
        self.editing.move(self.step, to)
        self.choose(to)

    def _filed(self, how: str) -> None:
        if how == "Save":
            self._say(f"wrote {self.editing.save()}")
        elif not self.editing.undo(1 if how == "Undo" else -1):
            self._say("nothing to undo" if how == "Undo" else "nothing to do again")

    def _dropped(self, handle: Handle, place: Any) -> None:
        """Take over where a handle has been put, or show again where it was."""
        by = np.round(np.asarray(place) - handle.place, DECIMALS)
        if not np.any(by):
            return
        try:
            self.editing.drag(self.step, handle.name, handle.place + by)
        except HitchoptError:
            self._build()
            raise

    def _ball(self, handle: Handle) -> Any:
        colour = CHOSEN_COLOUR if handle.name == self.handle else IDLE_COLOUR
        ball = self.live.server.scene.add_icosphere(
            f"/edit/{handle.name}", SIZE, colour, position=tuple(handle.place), cast_shadow=False
        )
        ball.on_click(lambda _: self._do(self.choose, self.step, handle.name))
        return ball

    def _gizmo(self, handle: Handle) -> Any:
        gizmo = self.live.server.scene.add_transform_controls(
            "/edit/gizmo", REACH, active_axes=(True, True, handle.vertical), disable_rotations=True,
            depth_test=False, position=tuple(handle.place),
        )  # fmt: skip

        def moved(event: Any) -> None:
            if event.phase == "end":
                self._do(self._dropped, handle, np.array(event.target.position))

        gizmo.on_update(moved)
        return gizmo

    def _button(
        self, label: str, work: Callable[..., None], *args: Any, hint: str | None = None
    ) -> Any:
        button = self.live.server.gui.add_button(label, hint=hint)
        button.on_click(lambda _: self._do(work, *args))
        return button

    def _do(self, work: Callable[..., None], *args: Any) -> None:
        """Do the work of a button, or show the error."""
        with self._lock:
            self._say("")
            try:
                work(*args)
            except HitchoptError as error:
                self._say(str(error))

    def _say(self, words: str) -> None:
        self.reply.content = plain_words(words)
        self.reply.visible = bool(words)
