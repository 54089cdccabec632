"""The page of the live view before anything is drawn in it, and its light.

It needs viser alone: browsers load the page while the plan is read.
"""

from __future__ import annotations

from typing import Any

from hitchopt.errors import UnsupportedError

HOST, PORT = "127.0.0.1", 8080
"""Where the server listens unless told otherwise: this machine alone; if the port is taken, the
next free one."""

WIDTH, FIELD = 380, 0.6
"""Width of the panel [pixels], and vertical field of view [rad]."""

SKY, GROUND, BRIGHTNESS = (255, 255, 255), (190, 190, 205), 1.8
"""Colours of the light from above and from below, and its intensity."""

Z_FROM_Y = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
"""Attitude that turns the y axis, along which viser has the sky, to the z axis."""

SIDE, SIDE_BRIGHTNESS = (-1.0, -0.3, 0.3), 1.0
"""Direction that a lamp shines from, so that the sides of boxes differ, and its intensity."""


def open_server(host: str = HOST, port: int = PORT) -> Any:
    """Return a viser server that serves an empty page; without viser, raise UnsupportedError."""
    try:
        import viser
    except ImportError:
        words = "the live view needs viser, which is not installed; pip install 'hitchopt[view]'"
        raise UnsupportedError(words) from None
    server = viser.ViserServer(host, port, label="hitchopt", verbose=False)
    server.scene.set_up_direction("+z")
    _add_light(server.scene)
    # Without the button that shares the page through a server elsewhere.
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(WIDTH)
    server.initial_camera.fov = FIELD
    return server


def server_address(server: Any) -> str:
    """Return the address of the page that a server serves."""
    return f"http://{server.get_host()}:{server.get_port()}"


def _add_light(api: Any) -> None:
    """Light a viser scene from the sky, the ground and one side, without shadows.

    It stands for the photograph that viser lights scenes with: where graphics are drawn by
    software, preparing that takes a browser seconds, in which it shows nothing.
    """
    api.configure_environment_map(None)
    api.configure_default_lights(cast_shadow=False)
    api.add_light_hemisphere(
        "/light/sky", sky_color=SKY, ground_color=GROUND, intensity=BRIGHTNESS, wxyz=Z_FROM_Y
    )
    api.add_light_directional("/light/side", intensity=SIDE_BRIGHTNESS, position=SIDE)
