"""The robot in its world on the page, and the frames that it is drawn from."""

import asyncio
import json
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui.element import Element
from starlette.websockets import WebSocket, WebSocketDisconnect

from evogymcm.envs.render import palette
from evogymcm.envs.render.renderer import VIEWS
from evogymcm.sim.constants import FIXED
from evogymcm.studio.page.grid import hex_color
from evogymcm.studio.watching import Watch

if TYPE_CHECKING:
    from evogymcm.studio.player import Player

ASPECT = 2.0
_OFTEN, _SELDOM = 0.008, 0.05  # seconds between looks at a robot that moves, or stands
_AWAKE = 1.0  # seconds without a change after which it stands
_GONE = "gone"  # what stands for a closed tab
_NOTHING = (0, -1)  # the scene without a robot
_ENDINGS = ("", "goal", "failure", "time", "unstable")
_PALETTE = {
    "sky": hex_color(palette.SKY),
    "floor": hex_color(palette.FLOOR),
    "goal": hex_color(palette.GOAL),
    "ink": hex_color(palette.INK),
    "fixed": hex_color(palette.type_color(FIXED)),
    "neutralFixed": hex_color(palette.NEUTRAL_FIXED),
}


class SceneCanvas(Element, component="scene.js"):
    """A picture of a design that moves.

    Args:
        source: The path of its websocket.
        aspect: Width over height.
    """

    def __init__(self, source: str, aspect: float = ASPECT) -> None:
        super().__init__()
        label = "the robot in its world"
        self._props.update(source=source, view=VIEWS[0], aspect=aspect, palette=_PALETTE, label=label)

    def look(self, view: str) -> None:
        """Shows types or stiffness."""
        self._props["view"] = view
        self.update()


async def stream(socket: WebSocket, watch: Watch) -> None:
    """Sends frames of a robot: one for each that the page asks for, as soon as something has changed."""
    await socket.accept()
    asked: asyncio.Queue[str] = asyncio.Queue()
    reader = asyncio.ensure_future(_read(socket, asked))
    try:
        with watch.viewed():
            await _send_frames(socket, watch, asked)
    except (WebSocketDisconnect, RuntimeError):
        pass  # the tab is closed
    finally:
        reader.cancel()


async def _read(socket: WebSocket, asked: "asyncio.Queue[str]") -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        while True:
            asked.put_nowait(await socket.receive_text())
    asked.put_nowait(_GONE)


async def _send_frames(socket: WebSocket, watch: Watch, asked: "asyncio.Queue[str]") -> None:
    request = ""  # what is asked for and not sent yet
    scene: tuple[int, int] | None = None  # what was sent last
    shown: tuple[Any, ...] | None = None
    aspect, view, pause, changed = ASPECT, VIEWS[0], _SELDOM, 0.0
    while True:
        with suppress(TimeoutError):
            request = await asyncio.wait_for(asked.get(), pause)
            if request == _GONE:
                return
            aspect, view = _read_request(request)
        player, pause = watch.player, _SELDOM
        if player is None:
            if scene != _NOTHING:
                await socket.send_text(json.dumps({"empty": True}))
                scene, shown = _NOTHING, None
            continue
        frame = player.frame(aspect)
        if scene != (id(player), frame["design"]):
            await socket.send_text(json.dumps(_scene(player, frame)))
            scene = (id(player), frame["design"])
        look = (scene, frame["episode"], frame["step"], view, aspect, frame["stiffness"].tobytes())
        if request and look != shown:
            await socket.send_bytes(pack(frame, view).tobytes())
            request, shown, changed = "", look, time.monotonic()
        pause = _OFTEN if request and time.monotonic() - changed < _AWAKE else _SELDOM


def _read_request(request: str) -> tuple[float, str]:
    aspect, _, view = request.partition(" ")
    try:
        number = float(aspect)
    except ValueError:
        number = ASPECT
    return (number if 0.2 <= number <= 5.0 else ASPECT), (view if view in VIEWS else VIEWS[0])


def _scene(player: "Player", frame: dict[str, Any]) -> dict[str, Any]:
    """Returns what stays from frame to frame, as the page takes it."""
    scene = player.scene()
    return {
        "types": frame["types"].tolist(),
        "sides": scene["sides"].astype(int).ravel().tolist(),
        "objectTypes": frame["objects"]["types"].tolist(),
        "objectSides": scene["object_sides"].astype(int).ravel().tolist(),
        "terrain": np.round(scene["terrain"][:, 0], 4).tolist(),  # the upper left corners
        "outline": np.round(scene["outline"].reshape(-1, 4), 4).tolist(),
        "goalX": scene["goal_x"],
        "goalY": scene["goal_y"],
    }


def pack(frame: dict[str, Any], view: str) -> np.ndarray:
    """Returns a frame as one float32 array.

    A head of 12 numbers (design, episode, env-step, score, the camera's box, whether it plays, how the episode ended,
    voxels of the robot and of others), then the robot's corners and colours, and those of other objects.
    """
    others = frame["objects"]
    if view == "types":
        colors = palette.type_colors(frame["types"], frame["stretch"], frame["stiffness"])
        other_colors = palette.type_colors(
            others["types"], np.ones(len(others["types"])), np.ones(len(others["types"]))
        )
    else:
        colors = palette.stiffness_colors(frame["stiffness"])
        other_colors = np.tile(palette.NEUTRAL, (len(others["types"]), 1))
    head = [
        *(frame["design"], frame["episode"], frame["step"], frame["score"]),
        *frame["camera"],
        *(frame["playing"], _ENDINGS.index(frame["ending"] or "")),
        *(len(frame["types"]), len(others["types"])),
    ]
    parts = [head, frame["corners"], colors, others["corners"], other_colors]
    return np.concatenate([np.ravel(part).astype(np.float32) for part in parts])
