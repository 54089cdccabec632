"""The live view: a plan in the browser, with playback, phases and certificate.

``open_server`` serves an empty page that browsers load while the plan is read.
"""

from __future__ import annotations

import itertools
import math
import threading
import time as clock
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.errors import optional_module
from hitchopt.geometry.vectors import unit
from hitchopt.motion.flight import Flight
from hitchopt.values import Array, known
from hitchopt.view.live_scene import SWITCHES, LiveScene
from hitchopt.view.own_pages import own_pages_only
from hitchopt.view.scene import Highlight, Scene, highlight_of, scene_of
from hitchopt.view.style import COLOURS, LIMIT_COLOUR, MARK_COLOUR, facts, verdict

HOST = "127.0.0.1"  # Default address of the server, on this machine only
PORT = 8080  # Default port; if it is in use, the next free one
WIDTH = 380  # Width of the panel [pixels]
FIELD_OF_VIEW = 0.6  # Vertical field of view [rad]
SKY_COLOUR = (255, 255, 255)  # Colour of the light from above
GROUND_COLOUR = (190, 190, 205)  # Colour of the light from below
BRIGHTNESS = 1.8  # Intensity of the light
# Rotation from the y axis, viser's direction of the sky, to the z axis
Z_FROM_Y = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
LAMP_DIRECTION = (-1.0, -0.3, 0.3)  # Direction of a lamp that makes the sides of boxes differ
LAMP_BRIGHTNESS = 1.0  # Intensity of that lamp
FRAME = 1.0 / 30.0  # Time between two frames [s]
STEP = 0.001  # Step of the time slider [s]
DECIMALS = 3  # Number of decimals of the time slider
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")

IDLE_COLOUR = "gray"  # Colour of buttons
CURRENT_COLOUR = "blue"  # Colour of the current phase; violated checks are red
PLOT_HEIGHT = 150  # Height of a plot with its legend [pixels]
# Frames between two updates of the plots' cursors, each of which sends all samples
CURSOR_FRAMES = 6
FOLLOW_DISTANCE = 4.0  # Distance of a following camera, in radii of the team
VIEW_DIRECTION = np.array([-0.35, -0.8, 0.5])  # Initial direction of the camera
MIN_DISTANCE = 1.5  # Minimum distance of the camera [m]
ASPECT = 1.0  # Width over height of the visible part of a usual window
FILLED_SHARE = 0.85  # Share of the visible part that drones fill


def open_server(host: str = HOST, port: int = PORT) -> Any:
    """Return a viser server with an empty page; raise UnsupportedError if viser is missing.

    It refuses WebSockets of pages of other servers. Light comes from the sky, the ground and one
    side, without shadows: software rendering takes seconds to prepare viser's environment map.
    """
    viser = optional_module("viser", "the live view needs", "view")
    with own_pages_only(host):
        server: Any = viser.ViserServer(host, port, label="hitchopt", verbose=False)
    scene, gui = server.scene, server.gui
    scene.set_up_direction("+z")
    scene.configure_environment_map(None)
    scene.configure_default_lights(cast_shadow=False)
    scene.add_light_hemisphere(
        "/light/sky", sky_color=SKY_COLOUR, ground_color=GROUND_COLOUR,
        intensity=BRIGHTNESS, wxyz=Z_FROM_Y,
    )  # fmt: skip
    scene.add_light_directional("/light/side", intensity=LAMP_BRIGHTNESS, position=LAMP_DIRECTION)
    _theme(gui, dark=False)
    gui.main_panel.dock_right()
    gui.main_panel.set_width(WIDTH)
    server.initial_camera.fov = FIELD_OF_VIEW
    return server


def _theme(gui: Any, *, dark: bool) -> None:
    """Set the page's colours, and hide the button that shares it through an external server."""
    gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)


def server_address(server: Any) -> str:
    """Return the address of a server's page."""
    return f"http://{server.get_host()}:{server.get_port()}"


class LiveView:
    """A plan in the browser, served until it is closed.

    Parameters
    ----------
    server: server of ``open_server``; browsers may already show its page.
    flight, certificate, title: plan; the certificate is None while it is being computed.
    ghost: scene that is shown pale in addition.
    """

    def __init__(
        self,
        server: Any,
        flight: Flight,
        certificate: Certificate | None,
        title: str = "",
        ghost: Scene | None = None,
    ) -> None:
        self.server = server
        self.time, self.playing, self.speed, self.following = 0.0, False, 1.0, False
        self.flight, self.certificate = flight, certificate
        self._title = title
        self._lock = threading.RLock()
        self._open = True
        self._ghost = None
        self._plots = list[tuple[Any, dict[str, Any]]]()
        self._cursor = math.nan
        with self.server.atomic():  # open pages show everything at once
            self.server.gui.set_panel_label(title or "hitchopt")
            self.live = LiveScene(self.server, scene_of(flight), "/plan/")
            self._place_camera(self.server.initial_camera, ASPECT)
            self._add_panel()
            if ghost is not None:
                self._ghost = LiveScene(self.server, ghost, "/ghost/", ghost=True)
        self.server.on_client_connect(self._widen_view)
        self._player = threading.Thread(target=self._play, daemon=True)
        self._player.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return server_address(self.server)

    def close(self) -> None:
        """Stop serving."""
        self._open = False
        self._player.join()
        self.server.stop()

    def show_certificate(self, certificate: Certificate) -> None:
        """Show the certificate of the current plan."""
        with self._lock, self.server.atomic():
            self.certificate = certificate
            self._show_head()
            labels = [_check_label(check) for check in certificate.checks]
            colours = [IDLE_COLOUR if check.holds else "red" for check in certificate.checks]
            with self._checks_tab:
                self.checks = self._buttons(labels, colours, self._show_check)
            self._show_plots(certificate)

    def seek(self, time: float) -> None:
        """Show the scene at a time [s]."""
        with self._lock:
            self.time = float(np.clip(time, 0.0, self.flight.duration))
            with self.server.atomic():
                self.live.show(self.time)
                if self._ghost is not None:
                    self._ghost.show(self.time)
                if self.following:
                    self._follow()
            self._show_phase()
            if abs(self.scrub.value - self.time) > 0.5 * FRAME:
                self.scrub.value = round(self.time, DECIMALS)

    def play(self, *, on: bool) -> None:
        """Start or stop the playback."""
        with self._lock:
            if on and self.time >= self.flight.duration:
                self.seek(0.0)
            self.playing = on
            self.player.label = "Pause" if on else "Play"

    def follow(self, *, on: bool) -> None:
        """Let the cameras of all pages follow the drones, or stop following."""
        with self._lock:
            self.following = on
            if on:
                self._follow(closer=True)

    def _follow(self, *, closer: bool = False) -> None:
        drones = self.live.scene.at(self.time).drones
        middle = np.mean(drones, axis=0)
        radius = float(np.max(np.linalg.norm(drones - middle, axis=1)))
        distance = max(FOLLOW_DISTANCE * radius, MIN_DISTANCE)
        for client in self.server.get_clients().values():
            camera = client.camera
            if camera.update_timestamp > 0.0:  # the page has reported its camera
                offset = camera.position - camera.look_at
                if closer:
                    offset *= min(1.0, distance / float(np.linalg.norm(offset)))
                camera.position = middle + offset
                camera.look_at = middle

    def _send_picture(self, client: Any) -> None:
        """Send a page a picture of its view as a file."""
        import imageio.v3 as imageio

        camera = client.camera
        picture = client.get_render(camera.image_height, camera.image_width)
        name = f"{self._title or 'plan'} {self.time:.2f} s.png"
        content = imageio.imwrite("<bytes>", picture[..., :3], extension=".png")
        client.send_file_download(name, content, save_immediately=True)

    def _play(self) -> None:
        """Advance the time during playback."""
        before = clock.monotonic()
        for frame in itertools.count():
            clock.sleep(FRAME)
            if not self._open:
                return
            now = clock.monotonic()
            if self.playing:
                with self._lock:
                    self.seek(self.time + self.speed * (now - before))
                    if self.time >= self.flight.duration:
                        self.play(on=False)
            if frame % CURSOR_FRAMES == 0:
                self._move_cursor()
            before = now

    def _place_camera(self, camera: Any, aspect: float) -> None:
        """Place a camera so that it shows all paths in a picture of an aspect ratio."""
        drones = self.live.scene.drones.reshape(-1, 3)
        centre = 0.5 * (np.min(drones, axis=0) + np.max(drones, axis=0))
        back = unit(VIEW_DIRECTION)
        right = unit(np.cross([0.0, 0.0, 1.0], back))
        seen = (drones - centre) @ np.column_stack([right, np.cross(back, right), back])
        slope = FILLED_SHARE * np.tan(0.5 * FIELD_OF_VIEW)
        needed = seen[:, 2] + np.max(np.abs(seen[:, :2]) / [slope * aspect, slope], axis=1)
        position = centre + max(float(np.max(needed)), MIN_DISTANCE) * back
        camera.position, camera.look_at = tuple(position), tuple(centre)

    def _widen_view(self, client: Any) -> None:
        """Move the camera of a narrow page farther away than the initial camera."""

        def widen(camera: Any) -> None:
            aspect = camera.image_width / camera.image_height
            initial = self.server.initial_camera
            if aspect < ASPECT and np.allclose(camera.position, initial.position, atol=1e-3):
                with self._lock:
                    self._place_camera(camera, aspect)

        client.camera.on_update(widen)
        widen(client.camera)

    def _add_panel(self) -> None:
        """Add the elements of the panel, and show the plan's start."""
        gui, phases = self.server.gui, self.flight.phases
        self.head, self.now = gui.add_markdown(""), gui.add_markdown("")
        longest = math.ceil(max(self.flight.duration, FRAME) / STEP) * STEP
        self.scrub = gui.add_slider("time [s]", 0.0, round(longest, DECIMALS), STEP, 0.0)
        self.player = gui.add_button("Play")
        space = gui.add_command("Play or pause", hotkey="space")
        space.on_trigger(lambda _: self.play(on=not self.playing))
        self.shown_check = gui.add_markdown("", visible=False)

        def scrub(event: Any) -> None:
            if event.client is not None:  # by hand, not by the playback
                self.seek(event.target.value)

        self.scrub.on_update(scrub)
        self.player.on_click(lambda _: self.play(on=not self.playing))
        self.panel = gui.add_panel()  # initially folded on narrow pages
        self.panel.dock_below(gui.main_panel)
        with self.panel.add_tab("Phases"):
            spans = [f"{phase.name}: {phase.start:.2f} – {phase.end:.2f} s" for phase in phases]
            colours = [IDLE_COLOUR] * len(spans)
            self.phases = self._buttons(spans, colours, lambda i: self.seek(phases[i].start))
        self._checks_tab = self.panel.add_tab("Certificate")
        with self._checks_tab:
            gui.add_markdown("Each worst value holds for all t. Click to see where and when.")
            gui.add_button("no highlight", color=IDLE_COLOUR).on_click(self._remove_highlight)
        self.checks = list[Any]()
        self._plots_tab = self.panel.add_tab("Plots")
        with self._plots_tab:
            self.values = gui.add_markdown("")
        with self.panel.add_tab("Show"):
            speed = gui.add_dropdown("speed", SPEEDS, initial_value=f"{self.speed:g}")
            speed.on_update(lambda event: setattr(self, "speed", float(event.target.value)))
            for name in SWITCHES:
                box = gui.add_checkbox(name, self.live.visible[name])
                box.on_update(lambda event, name=name: self._switch(name, on=event.target.value))
            follow, dark = gui.add_checkbox("follow", False), gui.add_checkbox("dark", False)
            follow.on_update(lambda event: self.follow(on=event.target.value))
            dark.on_update(lambda event: _theme(gui, dark=event.target.value))
            gui.add_button("PNG").on_click(lambda event: self._send_picture(event.client))
        self._show_head()
        if self.certificate is not None:
            self.show_certificate(self.certificate)
        self.seek(self.time)

    def _buttons(
        self, labels: Sequence[str], colours: Sequence[str], on_click: Callable[[int], None]
    ) -> list[Any]:
        """Add buttons to the current tab; return them. Clicks call ``on_click`` with the index."""
        buttons = list[Any]()
        for i, (label, colour) in enumerate(zip(labels, colours, strict=True)):
            button = self.server.gui.add_button(label, color=colour)
            button.on_click(lambda _, i=i: on_click(i))
            buttons.append(button)
        return buttons

    def _show_head(self) -> None:
        state = "being certified …" if self.certificate is None else verdict(self.certificate)
        title = plain_words(self._title or "Plan")
        self.head.content = f"### {title}\n{facts(self.flight)}  \n**{state}**"

    def _show_phase(self) -> None:
        phases, duration = self.flight.phases, self.flight.duration
        current = next((i for i, p in enumerate(phases) if self.time < p.end), len(phases) - 1)
        phase = phases[current]
        for i, button in enumerate(self.phases):
            if button.color != (colour := CURRENT_COLOUR if i == current else IDLE_COLOUR):
                button.color = colour
        state = f" ({phase.state})" if phase.state.has_cables else ""
        line = f"**{self.time:.2f} s** of {duration:.2f} s: **{phase.name}**{state}"
        remark = plain_words(phase.remark)
        self.now.content = f"{line}  \n{remark}" if remark else line

    def _show_plots(self, certificate: Certificate) -> None:
        """Show the report's plots."""
        from hitchopt.view.report import plots_of  # imports matplotlib, which is slow

        for plot in plots_of(self.flight, certificate):
            t = np.array(plot["t"])
            columns = [t]
            series = list[dict[str, Any]]([{"label": "t [s]"}])
            for k, curve in enumerate(plot["curves"]):
                columns.append(np.array(curve, np.float64))
                label = ("smallest", "largest")[k] if len(plot["curves"]) > 1 else "worst drone"
                series.append({"label": label, "stroke": COLOURS[1], "width": 1.5})
            for each in plot["limits"]:
                columns.append(np.interp(t, each["t"], np.array(each["values"], np.float64)))
                series.append({"label": "limit", "stroke": LIMIT_COLOUR, "dash": (6, 3)})
            columns.append(_cursor_line(t, self.time, plot["top"]))
            series.append({"label": "now", "stroke": MARK_COLOUR, "points": {"show": False}})
            scales = {"x": {"time": False}, "y": {"range": (0.0, plot["top"])}}
            with self._plots_tab:
                element = self.server.gui.add_uplot(
                    tuple(columns), tuple(series), title=plot["label"].replace("\n", " "),
                    scales=scales, height=PLOT_HEIGHT, legend={"show": True},
                )  # fmt: skip
            self._plots.append((element, plot))

    def _move_cursor(self) -> None:
        """Move the cursors of all plots to the current time, and write the values there."""
        with self._lock:
            if self.time == self._cursor or self.certificate is None:
                return
            self._cursor = self.time
            lines = [f"at {self.time:.2f} s:"]
            for element, plot in self._plots:
                t = element.data[0]
                curves = element.data[1 : 1 + len(plot["curves"])]
                values = [float(np.interp(self.time, t, curve)) for curve in curves]
                span = " to ".join(f"{value:.3g}" for value in values if math.isfinite(value))
                lines.append(f"{plain_words(element.title)}: **{span or '–'}**")
                element.data = (*element.data[:-1], _cursor_line(t, self.time, plot["top"]))
            self.values.content = "  \n".join(lines)

    def _show_check(self, index: int) -> None:
        """Show the worst time of a check, and highlight its drones, cables and vertices."""
        check = known(self.certificate).checks[index]
        with self._lock:
            self.play(on=False)
            self.live.highlight(highlight_of(self.flight, check.where))
            where = f": {', '.join(check.where)}" if check.where else ""
            self.shown_check.content = f"{check.name}{where} at {check.time:.2f} s"
            self.shown_check.visible = True
            self.seek(check.time)

    def _switch(self, name: str, *, on: bool) -> None:
        with self._lock:
            self.live.switch(name, on=on)

    def _remove_highlight(self, _: Any) -> None:
        with self._lock:
            self.live.highlight(Highlight())
            self.shown_check.visible = False


def _cursor_line(t: Array, time: float, top: float) -> Array:
    """Return the values of a vertical line at the samples next to a time, nan elsewhere."""
    values = np.full(len(t), np.nan)
    after = int(np.clip(np.searchsorted(t, time), 1, len(t) - 1))
    values[after - 1 : after + 1] = 0.0, top
    return values


def _check_label(check: Check) -> str:
    unit = "" if check.unit in {"1", "ratio"} else f" {check.unit}"
    worst = f"{check.worst:.4g}{unit}" if check.is_evaluated else "–"
    relation = "≥" if check.sense == "min" else "≤"
    limit = "" if check.limit is None else f" {relation} {check.limit:.4g}"
    return f"{'✓' if check.holds else 'NO'} {check.name}: {worst}{limit}"


def plain_words(text: str) -> str:
    """Return a text without markup of Markdown or HTML."""
    return "".join(f"&#{ord(char)};" if char in "<>&*_`#[]()!\\|~$" else char for char in text)
