"""A population as a PettingZoo environment: every body an agent, alone in its own world."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from evogymcm._messages import brief, some
from evogymcm.body import Body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import BodySpec, as_bodies
from evogymcm.envs.render.display import Display
from evogymcm.envs.render.renderer import FPS, make_renderer
from evogymcm.envs.task import Task
from evogymcm.envs.voxels import N_FEATURES, N_SIDES, N_TYPES
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW, STIFFNESS_HIGH, STIFFNESS_LOW, Physics

Observation = dict[str, np.ndarray] | np.ndarray
Action = Mapping[str, np.ndarray] | np.ndarray
_RANGES = {"actuation": (ACTUATION_LOW, ACTUATION_HIGH), "stiffness": (STIFFNESS_LOW, STIFFNESS_HIGH)}


class BodiesParallelEnv(ParallelEnv[str, Observation, Action]):
    """P bodies as agents `body_0` ..., each in its own world of one task.

    A body that ends leaves `agents` in that step, and its world is simulated no further; the others go on. Bodies are
    padded to one grid of V cells, each in the upper left corner. Numbers in cells without an actuator (actuation) or
    voxel (stiffness) have no effect.

    Each agent observes a dict of `voxels` (V, F) float32 and `types` (V, 5) uint8 (see `evogymcm.envs.voxels`),
    `occupancy` and `actuators` (V,) int8, and `task` (G,) float32: COM velocity, sine and cosine of the orientation,
    the task's own global observations. It acts with a dict of `actuation` (V,) in [0.6, 1.6] and, in the reactive
    setting, `stiffness` (V,) in [0.5, 2]. Its `info` holds the numbers `score` (the episode's rewards but the last),
    `return` (all of them), `unstable`, `reached` (a goal), and `com_x` and `com_y` in metres.

    With `flat=True` observations and actions are float32 vectors instead, for what knows no dicts: the same parts in
    the order of `gymnasium.spaces.flatten`, by name: `actuators`, `occupancy`, `task`, `types`, `voxels`; `actuation`,
    `stiffness`.

    `reset(options={"bodies": [...], "stiffness": [...]})` takes new designs, from then on: as many as before, within
    the padded grid. Other options are ignored.

    Args:
        task: A task or its id.
        bodies: The P bodies.
        material: "invariant" or "reactive".
        stiffness: Invariant only: one field in [0.5, 2] for each body; None is 1 everywhere.
        edge_rule: How stiffness acts on shared edges: "mean_factor" or "mean_stiffness".
        seed: For tasks with random resets, until `reset` is given another.
        num_threads: Threads of the simulator; all cores by default.
        grid_shape: (rows, columns) of the padded grid; by default the smallest that holds every body. A larger one
            leaves room for later designs.
        render_mode: "rgb_array" (`render` returns a picture of all bodies), "human" (a window at every step) or None.
        render_options: Keywords of `Renderer`: width, height, view, legend.
        physics: Constants; the benchmark's by default.
        flat: Whether observations and actions are vectors.

    Attributes:
        np_random: The generator that `seed` makes, for new designs that come without a seed, and for wrappers.

    Raises:
        ValueError: For bad arguments, as `TaskEngine`, and in `reset` for designs that do not fit the spaces; in a step
            for a missing action, or one of a wrong shape or with NaN.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "evogymcm_bodies_v0",
        "render_modes": ["rgb_array", "human"],
        "render_fps": FPS,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec],
        *,
        material: str = "invariant",
        stiffness: np.ndarray | Sequence[np.ndarray | None] | None = None,
        edge_rule: str = "mean_factor",
        seed: int | None = 0,
        num_threads: int | None = None,
        grid_shape: tuple[int, int] | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        physics: Physics | None = None,
        flat: bool = False,
    ) -> None:
        modes = self.metadata["render_modes"]
        if render_mode not in (None, *modes):
            raise ValueError(f"render_mode: got {render_mode!r}, allowed are None and {modes}")
        self.render_mode = render_mode
        self.flat = flat
        self._render_options = dict(render_options or {})
        self._options: dict[str, Any] = {
            "material": material,
            "edge_rule": edge_rule,
            "num_threads": num_threads,
            "physics": physics,
            "with_flat": False,
        }
        designs = as_bodies(bodies)
        smallest = (max(body.rows for body in designs), max(body.cols for body in designs))
        self.grid_shape = smallest if grid_shape is None else (int(grid_shape[0]), int(grid_shape[1]))
        self.possible_agents = [f"body_{i}" for i in range(len(designs))]
        self.agents: list[str] = []
        self._index = {agent: i for i, agent in enumerate(self.possible_agents)}
        self.np_random = np.random.default_rng(seed)
        self._build(task, designs, stiffness, seed)
        self._heads = ("actuation", "stiffness") if material == "reactive" else ("actuation",)
        self._make_spaces()
        self._window = Display(self.task.id, FPS) if render_mode == "human" else None

    def _build(self, task: str | Task, designs: Sequence[Body], stiffness: Any, seed: int | None) -> None:
        """Makes the engine for these designs, and maps the cells of its grid to ours."""
        self._check_designs(designs)
        self.engine = TaskEngine(task, designs, stiffness=stiffness, seed=seed, **self._options)
        rows, columns = self.engine.grid_shape
        self._cells = (np.arange(rows)[:, None] * self.grid_shape[1] + np.arange(columns)).ravel()
        self._masks = [self._pad(flags.astype(np.int8)) for flags in (self.engine.occupancy, self.engine.actuators)]
        self._renderer = make_renderer(self.engine, self.render_mode, self._render_options)

    def _check_designs(self, designs: Sequence[Body]) -> None:
        if len(designs) != len(self.possible_agents):
            raise ValueError(f"bodies: got {len(designs)}, this environment has {len(self.possible_agents)} agents")
        for body in designs:
            if body.rows > self.grid_shape[0] or body.cols > self.grid_shape[1]:
                raise ValueError(f"bodies: got one of shape {body.shape}, the padded grid is {self.grid_shape}")

    def _make_spaces(self) -> None:
        n, n_features = self.n_cells, self.engine.features.shape[1]

        def numbers(*shape: int) -> spaces.Box:
            return spaces.Box(-np.inf, np.inf, shape, np.float32)

        def flags() -> spaces.Box:
            return spaces.Box(0, 1, (n,), np.int8)

        def given(**parts: spaces.Space[Any]) -> spaces.Space[Any]:
            return spaces.flatten_space(spaces.Dict(parts)) if self.flat else spaces.Dict(parts)

        types = spaces.Box(0, N_TYPES - 1, (n, N_SIDES), np.uint8)
        voxels, task = numbers(n, N_FEATURES), numbers(n_features)
        self.observation_spaces = {
            agent: given(voxels=voxels, types=types, occupancy=flags(), actuators=flags(), task=task)
            for agent in self.possible_agents
        }
        self.action_spaces = {
            agent: given(**{head: spaces.Box(*_RANGES[head], (n,), np.float32) for head in self._heads})
            for agent in self.possible_agents
        }
        self.state_space = numbers(self.max_num_agents * (n * N_FEATURES + n_features))

    @property
    def task(self) -> Task:
        """The task."""
        return self.engine.task

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The present bodies."""
        return self.engine.bodies

    @property
    def n_cells(self) -> int:
        """V, cells of the padded grid."""
        return self.grid_shape[0] * self.grid_shape[1]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's observation space, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's action space, always the same object."""
        return self.action_spaces[agent]

    def _pad(self, values: np.ndarray) -> np.ndarray:
        """Returns (P, cells of the engine, ...) values on our grid, in fresh memory."""
        padded = np.zeros((len(values), self.n_cells, *values.shape[2:]), values.dtype)
        padded[:, self._cells] = values
        return padded

    def _observe(self, agents: Sequence[str]) -> dict[str, Observation]:
        engine, (occupancy, actuators) = self.engine, (mask.copy() for mask in self._masks)
        parts = {
            "voxels": self._pad(engine.voxels),
            "types": self._pad(engine.types),
            "occupancy": occupancy,
            "actuators": actuators,
            "task": engine.features.astype(np.float32),
        }
        if self.flat:
            columns = [parts[key].reshape(self.max_num_agents, -1).astype(np.float32) for key in sorted(parts)]
            rows = np.concatenate(columns, axis=1)
            return {agent: rows[self._index[agent]] for agent in agents}
        return {agent: {key: values[self._index[agent]] for key, values in parts.items()} for agent in agents}

    def _infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        engine = self.engine
        x, y = engine.com.T.tolist()
        columns = {
            "score": engine.score.tolist(),
            "return": engine.returns.tolist(),
            "unstable": engine.unstable.tolist(),
            "reached": engine.reached.tolist(),
            "com_x": x,
            "com_y": y,
        }
        return {agent: {name: values[self._index[agent]] for name, values in columns.items()} for agent in agents}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Starts new episodes of all bodies, with new designs where `options` names them.

        Args:
            seed: For tasks with random resets; None goes on with the present random numbers.
            options: `bodies`: new bodies, as many as before. `stiffness`: their fields, or new ones of the present
                bodies; None (also where only bodies are given) is 1 everywhere.

        Returns:
            Observations and infos of all agents.

        Raises:
            ValueError: For designs that do not fit the spaces.
        """
        options = options or {}
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        if "bodies" in options or "stiffness" in options:
            designs = as_bodies(options["bodies"]) if "bodies" in options else self.bodies
            number = int(self.np_random.integers(2**31)) if seed is None else seed
            self._build(self.task, designs, options.get("stiffness"), number)
        if seed is not None:
            self.engine.set_seed(seed)
        self.engine.reset()
        self.agents = list(self.possible_agents)
        self._show()
        return self._observe(self.agents), self._infos(self.agents)

    def step(
        self, actions: Mapping[str, Action]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advances the worlds of all agents in `agents` by one env-step.

        Args:
            actions: One of each agent in `agents`; others are ignored.

        Returns:
            Observations, rewards, terminations, truncations and infos of these agents.
        """
        live, engine = self.agents, self.engine
        if not live:
            return {}, {}, {}, {}, {}
        missing = [agent for agent in live if agent not in actions]
        if missing:
            raise ValueError(f"actions: got none for {some(missing)}, each agent in `agents` needs one")
        rows = [self._index[agent] for agent in live]
        given = {head: self._spread(head, live, rows, actions) for head in self._heads}
        going = None
        if len(live) < self.max_num_agents:
            going = np.zeros(self.max_num_agents, bool)
            going[rows] = True
        engine.step(given["actuation"], given.get("stiffness"), going)
        self._show()
        reward, terminated, truncated = engine.reward.tolist(), engine.terminated.tolist(), engine.truncated.tolist()
        pairs = list(zip(live, rows, strict=True))
        self.agents = [agent for agent, i in pairs if not (terminated[i] or truncated[i])]
        return (
            self._observe(live),
            {agent: reward[i] for agent, i in pairs},
            {agent: terminated[i] for agent, i in pairs},
            {agent: truncated[i] for agent, i in pairs},
            self._infos(live),
        )

    def _spread(self, head: str, live: Sequence[str], rows: list[int], actions: Mapping[str, Action]) -> np.ndarray:
        """Returns one action entry of all worlds on the engine's grid, 1 in the worlds that have ended."""
        try:
            values = np.array([self._part(actions[agent], head) for agent in live], np.float64)
        except (IndexError, KeyError, TypeError, ValueError):
            values = np.empty(0)
        if values.shape != (len(live), self.n_cells):
            self._blame(head, live, actions)
        spread = np.ones((self.max_num_agents, len(self._cells)))
        spread[rows] = values[:, self._cells]
        return spread

    def _part(self, action: Any, head: str) -> Any:
        """Returns one entry of an action, nothing of a vector that is not as long as all entries."""
        if not self.flat:
            return action[head]
        vector, start = np.asarray(action), self._heads.index(head) * self.n_cells
        is_whole = vector.shape == (len(self._heads) * self.n_cells,)
        return vector[start : start + self.n_cells] if is_whole else ()

    def _blame(self, head: str, live: Sequence[str], actions: Mapping[str, Action]) -> None:
        """Raises a ValueError that says which agent's action is wrong."""
        for agent in live:
            action, what, wanted = actions[agent], f"{head} of {agent}", "(cells,)"
            size = self.n_cells
            if self.flat:
                value, what, size = action, f"action of {agent}", len(self._heads) * self.n_cells
                wanted = " + ".join(f"({head},)" for head in self._heads)
            elif not isinstance(action, Mapping) or head not in action:
                got = brief(list(action)) if isinstance(action, Mapping) else type(action).__name__
                raise ValueError(f"action of {agent}: got {got}, expected a dict with {list(self._heads)}")
            else:
                value = action[head]
            try:
                shape = np.asarray(value, np.float64).shape
            except (TypeError, ValueError):
                raise ValueError(f"{what}: got {brief(value)}, expected numbers") from None
            if shape != (size,):
                raise ValueError(f"{what}: got shape {shape}, expected {wanted} = ({size},)")

    def state(self) -> np.ndarray:
        """Returns what all bodies observe, also those that have ended, as one float32 vector: `voxels`, then `task`."""
        voxels, task = self._pad(self.engine.voxels), self.engine.features.astype(np.float32)
        return np.concatenate([voxels.ravel(), task.ravel()])

    def render(self) -> np.ndarray | None:
        """Returns a picture of all bodies, uint8 (height, width, 3), where `render_mode` is "rgb_array"."""
        return self._renderer.grid() if self._renderer and not self._window else None

    def _show(self) -> None:
        if self._renderer and self._window and not self._window.is_closed:
            self._window.show(self._renderer.grid())

    def close(self) -> None:
        """Closes the window, where there is one, and ends the simulator's threads; a later step starts them again."""
        self.engine.close()
        if self._window:
            self._window.close()


parallel_env = BodiesParallelEnv  # PettingZoo's name for what makes one: parallel_env("Walker-v0", bodies)

__all__ = ["BodiesParallelEnv", "parallel_env"]
