"""The task engine as a Gymnasium environment, single and vectorised.

Actions are flat, as in EvoGym: one actuation for each actuator, row-major; in the reactive setting followed by one
stiffness for each voxel, row-major.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from evogymcm._settings import check_count
from evogymcm.body import Body, as_body
from evogymcm.envs._per_world import PerWorld, VectorWorld
from evogymcm.envs.actions import ActionGrid
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import BodySpec, as_bodies
from evogymcm.envs.options import WorldOptions, lists_options
from evogymcm.envs.registration import Described
from evogymcm.envs.render.rendered import Rendered, check_render_mode
from evogymcm.envs.render.renderer import FPS, make_renderer
from evogymcm.envs.task import Task
from evogymcm.envs.world_readings import WorldReadings
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW, STIFFNESS_HIGH, STIFFNESS_LOW

_NO_LIMIT = -1  # Gymnasium's way to ask for episodes that only a task ends
_NOMINAL = 100.0  # bounds of the observation space, as in EvoGym; nothing is clipped to them


def _single_spaces(engine: TaskEngine) -> tuple[spaces.Box, spaces.Box]:
    """Returns the observation and the action space of one world."""
    flat = engine.flat
    if flat is None:
        raise ValueError("body: worlds of one Gymnasium vector environment need equal bodies; see SoftRobotEnv")
    n_actuators, n_voxels = int(engine.actuators[0].sum()), int(engine.occupancy[0].sum())
    low, high = np.full(n_actuators, ACTUATION_LOW), np.full(n_actuators, ACTUATION_HIGH)
    if engine.material == "reactive":
        low = np.concatenate([low, np.full(n_voxels, STIFFNESS_LOW)])
        high = np.concatenate([high, np.full(n_voxels, STIFFNESS_HIGH)])
    observation = spaces.Box(-_NOMINAL, _NOMINAL, (flat.shape[1],), np.float64)
    return observation, spaces.Box(low, high, dtype=np.float64)


class GymnasiumEnv(Described, Rendered, WorldReadings, gymnasium.Env[np.ndarray, np.ndarray]):
    """One world of one task.

    It truncates nothing by itself: `gymnasium.make` puts it in a `TimeLimit` wrapper, with `max_episode_steps` or else
    the task's `time_limit`.

    `info` holds NumPy values: `com` (2,), `unstable`, `reached` (whether the episode ended at a goal), `score` (the sum
    of the episode's rewards without the last), `return` (the sum of all); and `physics`, the constants that differ from
    the benchmark's, if any. Where work is measured, see `WorldOptions`, there are also `actuation_work` and
    `stiffness_work`, which the episode has been supplied with, and `net_actuation_work` and `net_stiffness_work`.

    Args:
        task: A task or its id.
        body: Anything that `evogymcm.as_body` takes: a grid of codes, text, a robot's name.
        connections: (2, k) joined pairs of flat indices; all side-adjacent voxels by default.
        render_mode: "rgb_array" (`render` returns a picture), "human" (a window shows every step), or None. EvoGym's
            names for the two are "img" and "screen".
        render_options: Keywords of `Renderer`: width, height, view, legend, hide_background, hide_edges, hide_voxels;
            EvoGym's verbose and hide_grid have no effect.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape and work_weight, as all environments
            take them: see `WorldOptions`.

    Raises:
        ValueError: For bad arguments, as `TaskEngine`; in a step for NaN or a wrong number of values.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human", "img", "screen"], "render_fps": FPS}

    @lists_options
    def __init__(
        self,
        task: str | Task,
        body: BodySpec,
        connections: np.ndarray | None = None,
        *,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Unpack[WorldOptions],
    ) -> None:
        design = as_body(body) if connections is None else Body(as_body(body).grid, connections)
        self.render_mode = check_render_mode(render_mode, self.metadata)
        engine = TaskEngine(task, design, 1, seed=None, with_voxels=False, **options)
        WorldReadings.__init__(self, engine)
        self.observation_space, self.action_space = _single_spaces(self.engine)
        self._grid = ActionGrid(self.engine, self.action_space.shape)
        self._changed = engine.simulator.physics.changed()
        self._draw(render_options)

    def _observation(self) -> np.ndarray:
        flat = self.engine.flat
        assert flat is not None  # one body is equal to itself
        return flat[0]

    def _info(self) -> dict[str, Any]:
        engine = self.engine
        info = {
            "com": engine.snapshot.robot.com[0].copy(),
            "unstable": engine.unstable[0],
            "reached": engine.reached[0],
            "score": engine.score[0],
            "return": engine.returns[0],
            **{name: values[0] for name, values in engine.works.items()},
        }
        return info | {"physics": dict(self._changed)} if self._changed else info

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Starts an episode; a seed matters to tasks that draw something at random."""
        super().reset(seed=seed)
        if seed is not None:
            self.engine.set_seed(seed)
        self.engine.reset()
        self._show()
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advances the world by one env-step; actions are clipped to their range."""
        engine = self.engine
        engine.step(*self._grid.spread(action))
        self._show()
        return self._observation(), engine.reward.item(), engine.terminated.item(), False, self._info()

    def render(self) -> np.ndarray | None:
        """Returns a picture, uint8 (height, width, 3), where `render_mode` is "rgb_array"; see `Renderer`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render: no render_mode was given to the environment")
        return super().render()


class GymnasiumVectorEnv(Described, PerWorld, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many worlds of one task, stepped together; bodies must be equal.

    `info` has the entries of `GymnasiumEnv`, with a row for each world.

    Args:
        task: A task or its id.
        body: One body or a list of `num_envs`.
        num_envs: Number of worlds.
        connections: (2, k) joined pairs of the one body.
        autoreset_mode: NEXT_STEP (the step after an end resets), SAME_STEP (ended worlds reset at once; the last
            observation and info are in `info`), or DISABLED (the caller resets with `options={"reset_mask": mask}`).
        max_episode_steps: Env-steps after which an episode is cut; -1 for no limit. The task's `time_limit` by default.
        render_mode: "rgb_array" or "img" (`render` returns a tuple of pictures, one a world), or None.
        render_options: As for `GymnasiumEnv`.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape and work_weight, as all environments
            take them: see `WorldOptions`.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array", "img"],
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    @lists_options
    def __init__(
        self,
        task: str | Task,
        body: BodySpec | Sequence[BodySpec],
        num_envs: int = 1,
        connections: np.ndarray | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Unpack[WorldOptions],
    ) -> None:
        self.render_mode = check_render_mode(render_mode, self.metadata)
        designs = as_bodies(body)
        if connections is not None:
            designs = [Body(design.grid, connections) for design in designs]
        num_envs = check_count("num_envs", num_envs)
        if len(designs) not in (1, num_envs):
            raise ValueError(f"body: got {len(designs)}, expected 1 or num_envs = {num_envs}")
        if max_episode_steps is not None and max_episode_steps != _NO_LIMIT:
            max_episode_steps = check_count("max_episode_steps (-1 for no limit)", max_episode_steps)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.engine = TaskEngine(task, designs, num_envs, seed=None, with_voxels=False, **options)
        self.changed = self.engine.simulator.physics.changed()  # constants that are not the benchmark's
        self.num_envs = num_envs
        self._limit = self.engine.task.time_limit if max_episode_steps is None else max_episode_steps
        self.single_observation_space, self.single_action_space = _single_spaces(self.engine)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._grid = ActionGrid(self.engine, (num_envs, *self.single_action_space.shape))
        self._ended = np.zeros(num_envs, bool)
        self._renderer = make_renderer(self.engine, render_mode, render_options)
        self.worlds = [VectorWorld(self, world) for world in range(num_envs)]

    def _observation(self) -> np.ndarray:
        flat = self.engine.flat
        assert flat is not None  # checked when the spaces were made
        return flat

    def _info(self) -> dict[str, Any]:
        engine, all_worlds = self.engine, np.ones(self.num_envs, bool)
        info: dict[str, Any] = {
            "com": engine.com,
            "unstable": engine.unstable.copy(),
            "reached": engine.reached.copy(),
            "score": engine.score.copy(),
            "return": engine.returns.copy(),
            **engine.works,
        }
        changed = {name: np.full(self.num_envs, value) for name, value in self.changed.items()}
        if changed:
            info["physics"] = changed | {f"_{name}": all_worlds.copy() for name in changed}
        return info | {f"_{key}": all_worlds.copy() for key in info}

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts episodes, in all worlds or in those of `options["reset_mask"]`; world i gets seed + i."""
        super().reset(seed=seed if not isinstance(seed, list) else None)
        if seed is not None:
            self.engine.set_seed(seed)
        mask = None if options is None else options.get("reset_mask")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
                raise ValueError(
                    f"reset_mask: got {mask.dtype} {mask.shape}, expected ({self.num_envs},) bool, some True"
                )
        self.engine.reset(mask)
        self._ended &= False if mask is None else ~mask
        return self._observation(), self._info()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advances the worlds by one env-step, and resets ended ones as `autoreset_mode` says."""
        engine = self.engine
        was_ended = self._ended & (self.autoreset_mode == AutoresetMode.NEXT_STEP)
        actuation, stiffness = self._grid.spread(actions)
        going = ~was_ended
        engine.step(actuation, stiffness, None if going.all() else going)
        if was_ended.any():
            engine.reset(was_ended)
        reward, terminated = engine.reward.copy(), engine.terminated.copy()
        truncated = engine.length >= self._limit if self._limit != _NO_LIMIT else np.zeros(self.num_envs, bool)
        self._ended = terminated | truncated
        observation, info = self._observation(), self._info()
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._ended.any():
            ended = self._ended
            finals = np.empty(self.num_envs, object)
            for world in np.flatnonzero(ended):
                finals[world] = observation[world].copy()
            info = {"final_obs": finals, "_final_obs": ended.copy(), "final_info": info, "_final_info": ended.copy()}
            engine.reset(ended)
            observation, info = self._observation(), info | self._info()
            self._ended = np.zeros(self.num_envs, bool)
        return observation, reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the simulator's threads; a later step starts them again."""
        if hasattr(self, "engine"):  # Gymnasium before 1.3 also closes what an error kept from being made
            self.engine.close()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Returns a picture of each world, uint8 (height, width, 3), where a `render_mode` was given."""
        if self._renderer is None:
            gymnasium.logger.warn("render: no render_mode was given to the environment")
            return None
        return tuple(self._renderer.frame(world) for world in range(self.num_envs))

    def picture(self, world: int) -> np.ndarray | None:
        """Returns a picture of one world, None where no `render_mode` was given."""
        return None if self._renderer is None else self._renderer.frame(world)
