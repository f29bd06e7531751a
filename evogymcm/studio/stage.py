"""One robot in its task, episode after episode, and what there is to see of it."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from evogymcm.algos.learning.playing import play
from evogymcm.body import Body, check_stiffness
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import on_grid
from evogymcm.envs.render.renderer import FPS
from evogymcm.envs.render.scenery import Camera, Parts, make_parts, stretches
from evogymcm.sim.constants import VOXEL
from evogymcm.studio.driving import Driver, Made

if TYPE_CHECKING:
    from evogymcm.algos.learning.playing import Episodes, Gait

_PADDING = (5, 3)  # voxels around the robot, across and up, as in pictures
_MOST_CAMERAS = 8


class View:
    """What is drawn of a design in its world; the part of a frame that stays from step to step.

    Args:
        stage: The stage.
        number: Of the design, counted from 0.
    """

    def __init__(self, stage: "Stage", number: int) -> None:
        engine = stage.engine
        self.number, self.body, self.parts = number, stage.body, make_parts(engine, 0)
        self._cameras: dict[float, Camera] = {}
        task, parts = engine.task, self.parts
        corners = VOXEL * (parts.squares[:, None] + np.array([[0, 1], [1, 1], [1, 0], [0, 0]]))
        ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)  # of the sides top, right, bottom, left
        points = engine.simulator.points(0)
        ceiling = float(engine.score_ceiling[0])
        self.scene = {
            "design": number,
            "body": self.body.text,
            "task": task.id,
            "about": task.about,
            "time_limit": int(task.time_limit),
            "score_ceiling": None if np.isnan(ceiling) else ceiling,
            "goal_x": getattr(task, "goal_x", None),
            "goal_y": getattr(task, "goal_y", None),
            "bounds": (*points.min(1).tolist(), *points.max(1).tolist()),
            "terrain": corners.astype(np.float32),
            "outline": ends[parts.square_sides].astype(np.float32),
            "cells": self._cells(parts, engine.grid_shape[1]),
            "sides": parts.sides[parts.first_robot :],
            "object_sides": parts.sides[: parts.first_robot],
        }

    @staticmethod
    def _cells(parts: Parts, columns: int) -> np.ndarray:
        return np.stack(np.divmod(parts.cells, columns), axis=1)

    def camera(self, points: np.ndarray, step: int, aspect: float) -> tuple[float, float, float, float]:
        """Returns the box (left, bottom, right, top) that a picture of that aspect shows, metres."""
        if aspect not in self._cameras and len(self._cameras) >= _MOST_CAMERAS:
            self._cameras.clear()
        camera = self._cameras.setdefault(aspect, Camera(_PADDING))
        x, y, height = camera.follow(points[:, self.parts.followed], step, aspect)
        width = height * aspect
        return x - width / 2, y - height / 2, x + width / 2, y + height / 2


@dataclass(frozen=True, eq=False)
class Shot:
    """The state after an env-step: arrays that no later step writes."""

    view: View
    episode: int
    step: int
    score: float
    returns: float
    ending: str | None
    is_mixed: bool
    points: np.ndarray = field(repr=False)  # (2, n) metres
    stiffness: np.ndarray = field(repr=False)  # (V,)

    def frame(self) -> dict[str, Any]:
        """Returns what a page draws, but for the camera's box; see `Player.frame`."""
        parts = self.view.parts
        quads = self.points.T[parts.corners]
        first, codes = parts.first_robot, parts.codes
        return {
            "design": self.view.number,
            "episode": self.episode,
            "step": self.step,
            "time": self.step / FPS,
            "score": self.score,
            "return": self.returns,
            "ending": self.ending,
            "mixed": self.is_mixed,
            "corners": quads[first:].astype(np.float32),
            "types": codes[first:].astype(np.int8),
            "stiffness": self.stiffness[parts.cells].astype(np.float32),
            "stretch": stretches(quads[first:], codes[first:]).astype(np.float32),
            "objects": {"corners": quads[:first].astype(np.float32), "types": codes[:first].astype(np.int8)},
        }


class Stage:
    """One world with a design in it, and what moves it.

    Args:
        driver: What moves robots, and where.
        body: The body.
        stiffness: (rows, columns) its field; None for 1, and in the reactive setting.
        seed: Of all draws.
        number: Of the design, counted from 0.
        episode: Episodes that have been before.

    Attributes:
        shot: What there is to see; a step replaces it.

    Raises:
        ValueError: The design is not valid, does not fit in the world, or the policy cannot move it.
    """

    def __init__(
        self, driver: Driver, body: Body, stiffness: Any, seed: int, number: int = 0, episode: int = 0
    ) -> None:
        self._driver, self.body, self.field = driver, body, _checked(stiffness, body, driver)
        self._take(*driver.make(body, self.field, seed), seed)
        self._view, self._episode = View(self, number), episode - 1
        self._begin()

    def _begin(self) -> None:
        """Begins an episode."""
        self._episode += 1
        self._is_mixed = False
        self._playing: Iterator[Episodes] = play(lambda engine: self._gait(engine), self.engine)
        self._show(next(self._playing))

    @property
    def has_ended(self) -> bool:
        """Whether the episode is over."""
        return self.shot.ending is not None

    def advance(self) -> None:
        """Makes an env-step; after an episode's end, or an error, it begins the next one instead."""
        now = None if self.has_ended else next(self._playing, None)
        if now is None:
            self._begin()
        else:
            self._show(now)

    def reset(self, seed: int | None) -> None:
        """Begins a new episode, with the draws of a seed where one is given, else with the next ones."""
        if seed is not None:
            self._take(*self._driver.make(self.body, self.field, seed), seed)
        self._begin()

    def _take(self, engine: TaskEngine, gait: "Gait", seed: int) -> None:
        self.engine, self._gait = engine, gait
        engine.set_seed(seed)  # the first episode begins with it, as in an environment

    def drive(self, driver: Driver, made: Made, seed: int) -> None:
        """Lets something else move the robot from now on, within the episode; `made` is by it and of this design."""
        self._driver, (engine, gait) = driver, made
        if engine.simulator.edge_rule != self.engine.simulator.edge_rule:  # the body moves otherwise
            self._take(engine, gait, seed)
            self._begin()
            return
        self._gait, self._is_mixed = gait, self.shot.step > 0
        self.engine.with_voxels = engine.with_voxels
        self.engine.refresh()
        self._show(self._now)

    def repaint(self, stiffness: Any) -> None:
        """Gives the body another stiffness field, within the episode."""
        field = _checked(stiffness, self.body, self._driver)
        if field is None:
            return
        self.field, engine = field, self.engine
        engine.stiffness = on_grid(field, engine.grid_shape, 1.0)[None]
        engine.simulator.set_stiffness(engine.stiffness)
        engine.refresh()
        self._is_mixed = self.shot.step > 0
        self._show(self._now)

    def _show(self, now: "Episodes") -> None:
        """Takes a picture of the present state."""
        self._now, engine = now, self.engine
        ending = None
        if not now.running[0]:
            ended = {"unstable": now.unstable[0], "goal": now.goal[0], "failure": engine.terminated[0]}
            ending = next((name for name, is_so in ended.items() if is_so), "time")
        self.shot = Shot(
            self._view,
            self._episode,
            now.step,
            float(now.score[0]),
            float(now.returns[0]),
            ending,
            self._is_mixed,
            engine.simulator.points(0),
            engine.stiffness[0].copy(),
        )


def _checked(stiffness: Any, body: Body, driver: Driver) -> np.ndarray | None:
    """Returns the stiffness field of a design, None where the policy sets it."""
    if driver.material != "reactive":
        return check_stiffness(stiffness, body)
    if stiffness is not None:
        raise ValueError("stiffness: in the reactive setting the policy sets it, expected None")
    return None
