"""The live view's panel for editing by hand, and handles in the scene."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.steps import STEP_KINDS
from hitchopt.steps.knob import Edit
from hitchopt.storage.yaml_file import Plain, flow, parse_yaml, split_key, value_at
from hitchopt.values.fields import keys_of
from hitchopt.view.editing import START, Editing, Handle, PlanState, Status, step_key
from hitchopt.view.live import LiveView, plain_words
from hitchopt.view.style import MARK_COLOUR

HANDLE_RADIUS = 0.04  # Radius of a handle [m]
ARROW_LENGTH = 0.35  # Length of the chosen handle's arrows [m]
# Colour of the chosen handle, as red, green and blue
CHOSEN_COLOUR = tuple(bytes.fromhex(MARK_COLOUR[1:]))
IDLE_COLOUR = (90, 96, 102)  # Colour of the other handles
MAX_HANDLES = 80  # Maximum number of handles of a step that are drawn, while the list has all
DECIMALS = 4  # Number of decimals of the offset by which a handle is dragged [m]


class EditingPanel:
    """Panel that edits a problem in the live view of its plan."""

    def __init__(self, live: LiveView, editing: Editing) -> None:
        self.live, self.editing = live, editing
        self.step = START
        self.handle = ""
        self._lock = threading.RLock()
        self._plan = editing.planned
        self._built_text = ""
        self._elements: list[Any] = []
        self._suggestion_buttons: list[Any] = []
        self._suggestions: tuple[Any, ...] = ()
        gui = live.server.gui
        self._tab = live.panel.add_tab("Edit")
        with self._tab:
            self.status = gui.add_markdown("")
            self.reply = gui.add_markdown("", visible=False)
            group = gui.add_button_group("file", ("Undo", "Redo", "Save"))
            group.on_click(lambda event: self._run(self._file_action, event.target.value))
        self._build()
        self._show_status(editing.status)
        editing.listener = self.refresh

    def refresh(self) -> None:
        """Show the current text, status and plan."""
        with self._lock:
            text, status, planned = self.editing.now()
            if planned is not self._plan:
                self._plan = planned
                title = self.editing.problem.title
                self.live.show_plan(planned.flight, planned.certificate, title)
            if text != self._built_text:
                self._build()
            self._show_status(status)

    def choose(self, step: int, handle: str = "") -> None:
        """Show the end of a step, or the start, and one of its handles."""
        with self._lock:
            if step != self.step:
                ends = [p.end for p in self._plan.flight.phases if p.step == step]
                self.live.seek(max(ends, default=0.0))
            self.step, self.handle = step, handle
            self._build()

    def _show_status(self, status: Status) -> None:
        """Show the relation of the plan to the problem, and the suggestions."""
        self.live.note("" if status.stage is PlanState.CURRENT else str(status.stage))
        disk = "saved" if self.editing.saved else "not saved"
        lines = [f"**{plain_words(str(status.stage))}** ({disk})"]
        if status.suggestions:
            lines.append("Click a suggested change below to apply it.")
        lines += map(plain_words, status.words.splitlines())
        self.status.content = "  \n".join(lines)
        if status.suggestions != self._suggestions:
            self._suggestions = status.suggestions
            for button in self._suggestion_buttons:
                button.remove()
            with self._tab:
                self._suggestion_buttons = [
                    self._button(str(x.change), self.editing.put, *x.change.edits, hint=str(x))
                    for x in status.suggestions
                ]

    def _build(self) -> None:
        """Build the elements that depend on the text and the step."""
        for element in self._elements:
            element.remove()
        self._built_text = self.editing.text
        data = parse_yaml(self._built_text)
        count = len(self.editing.problem.mission)
        self.step = min(self.step, count - 1)
        by_name = self.editing.handles(self.step)
        if self.handle not in by_name:
            self.handle = next(iter(by_name), "")
        with self._tab:
            folder = self.live.server.gui.add_folder("Step")
            with folder:
                self._add_steps(data, count)
                self._add_values(data, by_name)
        drawn = by_name.values() if len(by_name) <= MAX_HANDLES else ()
        self._elements = [folder, *map(self._ball, drawn)]
        if self.handle:
            self._elements.append(self._gizmo(by_name[self.handle]))

    def _add_steps(self, data: Plain, count: int) -> None:
        gui = self.live.server.gui
        names = [step_key(data, i) for i in range(START, count)]
        steps = gui.add_dropdown("step", names, initial_value=names[self.step - START])
        steps.on_update(
            lambda event: self._run(self.choose, names.index(event.target.value) + START)
        )
        kinds = gui.add_dropdown("new step", tuple(STEP_KINDS), initial_value="hold")

        def add_step() -> None:
            self.editing.add(self.step, kinds.value)
            self.choose(self.step + 1)

        self._button("Add after this step", add_step)
        if self.step != START:
            group = gui.add_button_group("this step", ("Earlier", "Later", "Remove"))
            group.on_click(lambda event: self._run(self._rearrange, event.target.value))

    def _add_values(self, data: Plain, by_name: dict[str, Handle]) -> None:
        gui = self.live.server.gui
        key = step_key(data, self.step)
        place = None
        if by_name:
            chosen = gui.add_dropdown("handle", tuple(by_name), initial_value=self.handle)
            chosen.on_update(lambda event: self._run(self.choose, self.step, event.target.value))
            here = tuple(map(float, by_name[self.handle].place))
            place = gui.add_vector3("x, y, z [m]", here, step=0.05)
        values = value_at(data, split_key(key))
        kind = STEP_KINDS.get(key.rpartition(".")[2]) if self.step != START else None
        names = values if kind is None else [key.name for key in keys_of(kind).values()]
        texts = {name: flow(values[name]) if name in values else "" for name in names}
        fields = {name: gui.add_text(name, text) for name, text in texts.items()}

        def plan() -> None:
            edits = [
                Edit(f"{key}.{name}", parse_yaml(field.value or "null", name))
                for name, field in fields.items()
                if field.value != texts[name]
            ]
            if edits:
                self.editing.put(*edits)
            elif place is not None:
                self._drop(by_name[self.handle], place.value)

        self._button("Plan with these values", plan)

    def _rearrange(self, how: str) -> None:
        if how == "Remove":
            self.editing.remove(self.step)
            return
        to = self.step + (1 if how == "Later" else -1)
        self.editing.move(self.step, to)
        self.choose(to)

    def _file_action(self, how: str) -> None:
        if how == "Save":
            self._reply(f"wrote {self.editing.save()}")
        elif not self.editing.undo(1 if how == "Undo" else -1):
            self._reply("nothing to undo" if how == "Undo" else "nothing to redo")

    def _drop(self, handle: Handle, place: Any) -> None:
        """Move a handle to a new position, or show the old one again after an error."""
        offset = np.round(np.asarray(place) - handle.place, DECIMALS)
        if not np.any(offset):
            return
        try:
            self.editing.drag(self.step, handle.name, handle.place + offset)
        except HitchoptError:
            self._build()
            raise

    def _ball(self, handle: Handle) -> Any:
        colour = CHOSEN_COLOUR if handle.name == self.handle else IDLE_COLOUR
        ball = self.live.server.scene.add_icosphere(
            f"/edit/{handle.name}", HANDLE_RADIUS, colour, position=tuple(handle.place),
            cast_shadow=False,
        )  # fmt: skip
        ball.on_click(lambda _: self._run(self.choose, self.step, handle.name))
        return ball

    def _gizmo(self, handle: Handle) -> Any:
        gizmo = self.live.server.scene.add_transform_controls(
            "/edit/gizmo", ARROW_LENGTH, active_axes=(True, True, handle.vertical),
            disable_rotations=True, depth_test=False, position=tuple(handle.place),
        )  # fmt: skip

        def move(event: Any) -> None:
            if event.phase == "end":
                self._run(self._drop, handle, np.array(event.target.position))

        gizmo.on_update(move)
        return gizmo

    def _button(
        self, label: str, action: Callable[..., None], *args: Any, hint: str | None = None
    ) -> Any:
        button = self.live.server.gui.add_button(label, hint=hint)
        button.on_click(lambda _: self._run(action, *args))
        return button

    def _run(self, action: Callable[..., None], *args: Any) -> None:
        """Run an action, or show its error."""
        with self._lock:
            self._reply("")
            try:
                action(*args)
            except HitchoptError as error:
                self._reply(str(error))

    def _reply(self, text: str) -> None:
        self.reply.content = plain_words(text)
        self.reply.visible = bool(text)
