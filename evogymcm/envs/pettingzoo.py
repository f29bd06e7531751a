"""A population as a PettingZoo environment: every body an agent, alone in its own world."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Unpack

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from evogymcm._messages import brief, some
from evogymcm.body import Body
from evogymcm.envs import checks
from evogymcm.envs.actions import RANGES
from evogymcm.envs.adapter import Adapter
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import BodySpec, as_bodies, check_grid_shape
from evogymcm.envs.options import EngineOptions, complete, lists_options
from evogymcm.envs.render.rendered import Rendered, check_render_mode
from evogymcm.envs.render.renderer import FPS, Renderer
from evogymcm.envs.task import Task
from evogymcm.envs.voxels import N_FEATURES, N_SIDES, N_TYPES

Observation = dict[str, np.ndarray] | np.ndarray
Action = Mapping[str, np.ndarray] | np.ndarray


class BodiesParallelEnv(Adapter, Rendered, ParallelEnv[str, Observation, Action]):
    """P bodies as agents `body_0` ..., each in its own world of one task.

    A body that ends leaves `agents` in that step, and its world is no longer simulated; the others continue. Bodies are
    padded to one grid of V cells, each in the upper left corner. Numbers in cells without an actuator (actuation) or
    voxel (stiffness) have no effect.

    Each agent observes a dict of `voxels` (V, F) float32 and `types` (V, 5) uint8 (see `evogymcm.envs.voxels`),
    `occupancy` and `actuators` (V,) int8, and `task` (G,) float32: COM velocity, sine and cosine of the orientation,
    the task's own global observations. It acts with a dict of `actuation` (V,) in [0.6, 1.6] and, in the reactive
    setting, `stiffness` (V,) in [0.5, 2]. Its `info` holds the numbers `score` (the sum of the episode's rewards
    without the last), `return` (the sum of all), `unstable`, `reached` (a goal), and `com_x` and `com_y` in metres; and
    the episode's work where it is measured, by the names that `GymnasiumEnv` has for it.

    With `flat=True` observations and actions are float32 vectors instead, for libraries that cannot handle dicts: the
    same parts in the order of `gymnasium.spaces.flatten`, by name: `actuators`, `occupancy`, `task`, `types`, `voxels`;
    `actuation`, `stiffness`.

    `reset(options={"bodies": [...], "stiffness": [...]})` changes the designs from then on: as many as before, within
    the padded grid. Other options are ignored.

    Args:
        task: A task or its id.
        bodies: The P bodies.
        render_mode: "rgb_array" (`render` returns a picture of all bodies), "human" (a window at every step) or None.
        render_options: Keywords of `Renderer`: width, height, view, legend.
        flat: Whether observations and actions are vectors.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape, work_weight and seed, as all
            environments take them: see `EngineOptions`. The padded grid stays as it is when bodies change.

    Attributes:
        np_random: The generator made from `seed`, for new designs that come without a seed, and for wrappers.

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

    @lists_options
    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec],
        *,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        flat: bool = False,
        **options: Unpack[EngineOptions],
    ) -> None:
        self.render_mode = check_render_mode(render_mode, self.metadata)
        self.flat = flat
        self._render_options = render_options
        designs, seed = as_bodies(bodies), complete(options)["seed"]
        self._options = options | {"grid_shape": check_grid_shape(options.get("grid_shape"), designs)}
        self.possible_agents = [f"body_{i}" for i in range(len(designs))]
        self.agents: list[str] = []
        self._index = {agent: i for i, agent in enumerate(self.possible_agents)}
        self.np_random = np.random.default_rng(checks.checked_seeds(seed, len(designs))[0])
        self._build(task, designs)
        self._make_spaces()
        self.engine.set_seed(seed)  # the first reset begins with it too

    def _build(self, task: str | Task, designs: Sequence[Body], **changed: Unpack[EngineOptions]) -> None:
        """Makes the engine for these designs, and what draws it."""
        if len(designs) != len(self.possible_agents):
            raise ValueError(f"bodies: got {len(designs)}, this environment has {len(self.possible_agents)} agents")
        self.engine = TaskEngine(task, designs, with_flat=False, **(self._options | changed))
        self._draw(self._render_options)

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
            agent: given(**{head: spaces.Box(*RANGES[head], (n,), np.float32) for head in self._heads})
            for agent in self.possible_agents
        }
        self.state_space = numbers(self.max_num_agents * (n * N_FEATURES + n_features))

    @property
    def n_cells(self) -> int:
        """V, cells of the padded grid."""
        return self.engine.simulator.n_cells

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's observation space, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's action space, always the same object."""
        return self.action_spaces[agent]

    def _observe(self, agents: Sequence[str]) -> dict[str, Observation]:
        if self.flat:
            rows = self.engine.vectors()
            return {agent: rows[self._index[agent]] for agent in agents}
        parts = self.engine.observations()
        parts |= {key: parts[key].astype(np.int8) for key in ("occupancy", "actuators")}
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
            **{name: values.tolist() for name, values in engine.works.items()},
        }
        return {agent: {name: values[self._index[agent]] for name, values in columns.items()} for agent in agents}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Starts new episodes of all bodies, with new designs where `options` names them.

        Args:
            seed: Seed for tasks with random resets; None continues with the current random numbers.
            options: `bodies`: new bodies, as many as before. `stiffness`: their fields, or new ones for the current
                bodies; None (also if only bodies are given) is 1 everywhere.

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
            self._build(self.task, designs, stiffness=options.get("stiffness"), seed=number)
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
            actions: One for each agent in `agents`; others are ignored.

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
        """Returns one action entry of all worlds, 1 in those that have ended."""
        try:
            values = np.array([self._part(actions[agent], head) for agent in live], np.float64)
        except (IndexError, KeyError, TypeError, ValueError, OverflowError):
            values = np.empty(0)
        if values.shape != (len(live), self.n_cells):
            self._blame(head, live, actions)
        spread = np.ones((self.max_num_agents, self.n_cells))
        spread[rows] = values
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
            except (TypeError, ValueError, OverflowError):
                raise ValueError(f"{what}: got {brief(value)}, expected numbers") from None
            if shape != (size,):
                raise ValueError(f"{what}: got shape {shape}, expected {wanted} = ({size},)")

    def state(self) -> np.ndarray:
        """Returns what all bodies observe, also those that have ended, as one float32 vector: `voxels`, then `task`."""
        return np.concatenate([self.engine.voxels.ravel(), self.engine.features.astype(np.float32).ravel()])

    def _picture(self, renderer: Renderer) -> np.ndarray:
        """Returns a picture of all bodies."""
        return renderer.grid()


parallel_env = BodiesParallelEnv  # PettingZoo's name for what makes one: parallel_env("Walker-v0", bodies)
