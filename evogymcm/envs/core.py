"""The task engine: one batched implementation of every task, for all adapters.

Arrays are indexed by world and by cell of the padded grid (V cells, bodies in the upper left corner).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from evogymcm._messages import brief
from evogymcm.body import Body
from evogymcm.envs import checks
from evogymcm.envs.designs import MATERIALS, BodySpec, as_bodies, deal_fields, on_grid
from evogymcm.envs.reader import BlockReader, Reader, Sensed
from evogymcm.envs.task import Snapshot, Task
from evogymcm.envs.tasks import as_task
from evogymcm.envs.voxels import N_FEATURES, voxel_template, voxel_types
from evogymcm.sim.constants import (
    ACTUATION_HIGH,
    ACTUATION_LOW,
    H_ACT,
    STIFFNESS_HIGH,
    STIFFNESS_LOW,
    V_ACT,
    Physics,
)
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.topology import Topology
from evogymcm.sim.world import ROBOT, World, WorldObject

UNSTABLE_PENALTY = -3.0
# Arrays that a step can change, besides the simulator and the task's memory.
_FLAGS = ("terminated", "truncated", "unstable", "reached")
_STATE = ("actuation", "stiffness", "reward", "score", "returns", "length", *_FLAGS)


class TaskEngine:
    """N worlds of one task, each with its body, stepped and reset together.

    Args:
        task: A task or its id.
        bodies: A body or a list of bodies (anything that `as_body` takes), dealt to the worlds in turn.
        num_worlds: N; as many as bodies by default.
        material: "invariant" (stiffness belongs to the body) or "reactive" (stiffness is part of every action).
        stiffness: Invariant only: a field of the body's shape in [0.5, 2], or one for each body; None is 1 everywhere.
        edge_rule: "mean_factor" or "mean_stiffness", see `evogymcm.sim.scene.build_scene`.
        physics: Constants; the benchmark's by default.
        num_threads: Threads; all cores by default.
        seed: For tasks with random resets, see `set_seed`.
        with_voxels: Whether to observe voxels (`self.voxels`).
        with_flat: Whether to form the flat observation, where all bodies are equal.

    Attributes:
        voxels: (N, V, F) float32 what voxels sense, see `voxels.py`.
        types: (N, V, 5) uint8 type codes of voxels and their neighbours, see `voxels.py`.
        flat: (N, D) the task's own observation, None where bodies differ.
        features: (N, G) COM velocity, sine and cosine of the orientation, and the task's own global parts.
        reward, terminated, truncated, unstable: (N,) of the last step.
        reached: (N,) bool, whether the last step ended the episode at a goal, see `Task.endings`.
        score: (N,) the sum of the episode's rewards but the last (the paper's score, once the episode has ended).
        returns: (N,) the sum of all of them.
        length: (N,) env-steps of the episode.
        num_designs: How many bodies were given: world w holds design w modulo this.

    Raises:
        ValueError: For an unknown task, material or edge rule, a body that is invalid or does not fit, a stiffness
            that is not finite, out of range, of another shape, or given in the reactive setting, and a task with
            mistakes, see `evogymcm.testing.check_task`.
    """

    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec],
        num_worlds: int | None = None,
        *,
        material: str = "invariant",
        stiffness: np.ndarray | Sequence[np.ndarray | None] | None = None,
        edge_rule: str = "mean_factor",
        physics: Physics | None = None,
        num_threads: int | None = None,
        seed: int | Sequence[int | None] | None = None,
        with_voxels: bool = True,
        with_flat: bool = True,
    ) -> None:
        self.task = as_task(task)
        if material not in MATERIALS:
            raise ValueError(f"material: got {material!r}, allowed are {MATERIALS}")
        self.material = material
        designs = as_bodies(bodies)
        n = len(designs) if num_worlds is None else num_worlds
        if n < 1:
            raise ValueError(f"num_worlds: got {n}, at least 1 is needed")
        self.num_worlds, self.num_designs = n, len(designs)
        self.bodies = tuple(designs[i % len(designs)] for i in range(n))
        with checks.blaming(self.task):
            world = self.task.world if isinstance(self.task.world, World) else World.load(self.task.world)
            checks.check_fields(self.task, world)
        placed = {body: self._place(world, body) for body in set(self.bodies)}
        scenes = [placed[body] for body in self.bodies]
        self.simulator = Simulator(scenes, edge_rule, physics, num_threads, placed=self.task.moves_at_reset)
        self.grid_shape = self.simulator.grid_shape
        self._fields = deal_fields(stiffness, designs, material, n, self.grid_shape)

        v = self.simulator.n_cells
        self.occupancy = np.stack([on_grid(b.occupancy, self.grid_shape, False) for b in self.bodies])
        self.actuators = np.stack(
            [on_grid(np.isin(b.grid, (H_ACT, V_ACT)), self.grid_shape, False) for b in self.bodies]
        )
        self.with_voxels = with_voxels
        self.types = self._per_body(voxel_types)
        self._template = self._per_body(voxel_template) if with_voxels else np.zeros((n, v, N_FEATURES), np.float32)
        self.voxels = self._template.copy()
        self._reader = Reader(self.task, self.simulator)
        self.is_uniform = with_flat and len(placed) == 1

        self.stiffness = np.ones((n, v)) if self._fields is None else self._fields.copy()
        self.actuation = np.ones((n, v))
        if self._fields is not None:
            self.simulator.set_stiffness(self.stiffness)
        self.reward, self.score, self.returns = np.zeros(n), np.zeros(n), np.zeros(n)
        self.length = np.zeros(n, np.int64)
        self.terminated, self.truncated, self.unstable, self.reached = (np.zeros(n, bool) for _ in _FLAGS)
        self.set_seed(seed)
        self.memory: dict[str, np.ndarray] = {}
        with checks.blaming(self.task):
            self.reset()
            checks.check_methods(self.task, self._reader.now)
        ceiling = self.task.score_ceiling(self._reader.now)
        self.score_ceiling = np.full(n, np.nan) if ceiling is None else np.array(ceiling)

    def _place(self, world: World, body: Body) -> tuple[WorldObject, ...]:
        robot = WorldObject(ROBOT, body.grid, self.task.spawn, body.connections)
        try:
            return world.place(robot).simulation_order()
        except ValueError as error:
            raise ValueError(f"body {brief(body.text)} does not fit in {self.task.id}: {error}") from error

    def _per_body(self, describe: Callable[[Body, Topology, tuple[int, int]], np.ndarray]) -> np.ndarray:
        """Returns (N, V, ...) what `describe` says of each world's body."""
        rows = {}
        for block in self.simulator.blocks:
            body = self.bodies[block.worlds[0]]
            if body not in rows:
                rows[body] = describe(body, block.scene.objects[0].topology, self.grid_shape)
        return np.stack([rows[body] for body in self.bodies])

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Starts new episodes in the worlds of the (N,) bool mask, in all by default."""
        chosen = np.ones(self.num_worlds, bool) if mask is None else checks.checked_mask(mask, self.num_worlds)
        self._draw(chosen)
        self.simulator.reset(chosen, self.memory["offset"] if self.task.moves_at_reset else None)
        self.actuation[chosen] = 1.0
        if self.material == "reactive":
            self.stiffness[chosen] = 1.0
        for values in (self.reward, self.score, self.returns, self.length):
            values[chosen] = 0
        for name in _FLAGS:
            getattr(self, name)[chosen] = False
        self._renew_voxels(mask)
        self._reader.remember(self.memory, chosen)
        self._reader.read(chosen, self._block_reader())

    def _block_reader(self) -> BlockReader:
        """Returns what reads a block into the present snapshot."""
        sensed = Sensed(self.stiffness, self.actuation, self._template, self.voxels) if self.with_voxels else None
        return self._reader.block_reader(sensed)

    def _draw(self, chosen: np.ndarray) -> None:
        """Draws what the episodes of the chosen worlds hold at random, each from its world's own generator."""
        for world in np.flatnonzero(chosen):
            row = checks.checked_draw(self.task, self.task.draw(self._rngs[world]), self.memory)
            if not self.memory:
                self.memory = {name: np.zeros((self.num_worlds, *v.shape), v.dtype) for name, v in row.items()}
            for name, value in row.items():
                self.memory[name][world] = value

    def step(self, actuation: np.ndarray, stiffness: np.ndarray | None = None, mask: np.ndarray | None = None) -> None:
        """Advances the worlds by one env-step; what comes of it is in the attributes.

        Args:
            actuation: (N, V) actuation, clipped to [0.6, 1.6]; cells without an actuator have no effect.
            stiffness: (N, V) stiffness, clipped to [0.5, 2]: needed in the reactive setting, not allowed otherwise.
            mask: (N,) bool, the worlds to advance; all by default. The others keep everything.

        Raises:
            ValueError: For another shape, or NaN at a voxel that uses the number.
        """
        given = checks.checked_action("actuation", actuation, self.actuators, ACTUATION_LOW, ACTUATION_HIGH)
        if (stiffness is None) == (self.material == "reactive"):
            needs = "needs stiffness in every action" if stiffness is None else "takes no stiffness in its actions"
            raise ValueError(f"stiffness: the {self.material} setting {needs}")
        factors = None
        if stiffness is not None:
            factors = checks.checked_action("stiffness", stiffness, self.occupancy, STIFFNESS_LOW, STIFFNESS_HIGH)
        if mask is None:
            self.actuation = given
            self.stiffness = self.stiffness if factors is None else factors
        else:
            mask = checks.checked_mask(mask, self.num_worlds)
            self.actuation[mask] = given[mask]
            if factors is not None:
                self.stiffness[mask] = factors[mask]
        self._reader.turn()
        self._reader.remember(self.memory, mask)
        self._renew_voxels(mask)
        unstable = self.simulator.step(self.actuation, factors, mask, self._block_reader())
        if mask is not None:
            self._reader.keep(~mask)
        self._reward(mask, unstable)

    def _renew_voxels(self, mask: np.ndarray | None) -> None:
        """Gives `voxels` fresh memory, since observations are kept; with the old values, unless all are to be read."""
        if self.with_voxels:
            self.voxels = np.empty_like(self._template) if mask is None else self.voxels.copy()

    def _reward(self, mask: np.ndarray | None, unstable: np.ndarray) -> None:
        """Rewards and endings of the step, for the worlds of the mask."""

        def chosen(new: np.ndarray, old: Any) -> np.ndarray:
            return new if mask is None else np.where(mask, new, old)

        before, now = self._reader.before, self._reader.now
        reward = checks.checked_reward(self.task.reward(before, now), self.num_worlds)
        terminated, reached = unstable.copy(), np.zeros_like(unstable)
        reward = reward + np.where(unstable, UNSTABLE_PENALTY, 0.0)
        for condition, bonus, is_goal in checks.checked_endings(self.task, now):
            reward = reward + np.where(condition, bonus, 0.0)
            terminated |= condition
            reached |= condition & is_goal
        for name, values in checks.checked_memory(self.task.remember(now), self.memory).items():
            rows = True if mask is None else mask.reshape(-1, *([1] * (values.ndim - 1)))
            self.memory[name] = np.where(rows, values, self.memory[name])
        self.length = self.length + (1 if mask is None else mask)
        self.score = chosen(self.returns, self.score)
        self.reward = chosen(reward, 0.0)
        self.returns = self.returns + self.reward
        self.terminated = chosen(terminated, self.terminated)
        self.truncated = chosen(self.length >= self.task.time_limit, self.truncated)
        self.unstable = chosen(unstable, self.unstable)
        self.reached = chosen(reached & ~unstable, self.reached)  # an unstable step goes nowhere

    @property
    def snapshot(self) -> Snapshot:
        """The present readings. They are overwritten by the step after the next."""
        return self._reader.now

    @property
    def com(self) -> np.ndarray:
        """(N, 2) the robots' centres of mass, metres."""
        return self._reader.now.robot.com.copy()

    @property
    def flat(self) -> np.ndarray | None:
        """(N, D) the task's own flat observation (fresh memory), None where bodies differ."""
        if not self.is_uniform:
            return None
        return np.concatenate(list(self.task.observation(self._reader.now).values()), axis=1)

    @property
    def features(self) -> np.ndarray:
        """(N, G) global features (fresh memory): COM velocity, sine and cosine of the orientation, the task's parts."""
        angle = self._reader.now.robot.orientation.copy()  # numpy's sine of a view may round otherwise
        parts = [self._reader.now.robot.velocity, np.sin(angle)[:, None], np.cos(angle)[:, None]]
        own = self.task.observation(self._reader.now)
        parts += [part for name, part in own.items() if name not in ("velocity", "orientation", "relative")]
        return np.concatenate(parts, axis=1)

    def set_seed(self, seed: int | Sequence[int | None] | None) -> None:
        """Seeds random resets: one seed for each world, or one for the first, from which the others count up.

        None draws from the operating system. Nothing happens before the next reset.
        """
        seeds = [None] * self.num_worlds if seed is None else seed
        if isinstance(seeds, int | np.integer):
            seeds = [int(seeds) + world for world in range(self.num_worlds)]
        if len(seeds) != self.num_worlds:
            raise ValueError(f"seed: got {len(seeds)} seeds, expected one for each of {self.num_worlds} worlds")
        self._rngs = [np.random.default_rng(value) for value in seeds]

    def state(self) -> dict[str, Any]:
        """Returns a copy of everything that a step or a reset can change, for `set_state`."""
        return {name: getattr(self, name).copy() for name in _STATE} | {
            "simulator": self.simulator.state(),
            "memory": {name: values.copy() for name, values in self.memory.items()},
            "shown": {name: values.copy() for name, values in self._reader.now.memory.items()},
            "rngs": [rng.bit_generator.state for rng in self._rngs] if self.memory else [],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Takes up a state of an engine made with the same arguments."""
        state = {"reached": np.zeros(self.num_worlds, bool)} | state  # which those of older releases lack
        for name in _STATE:
            setattr(self, name, np.array(state[name]))
        self.memory = {name: np.array(values) for name, values in state["memory"].items()}
        for rng, saved in zip(self._rngs, state["rngs"], strict=False):
            rng.bit_generator.state = saved
        self.simulator.set_state(state["simulator"])
        self.refresh()
        # The last observation was formed before the task's memory moved on.
        self._reader.remember(state["shown"])

    def close(self) -> None:
        """Ends the simulator's threads; a later step starts them again."""
        self.simulator.close()

    def refresh(self) -> None:
        """Reads all worlds anew, after the simulator's state or the memory was changed from outside."""
        self._renew_voxels(None)
        self._reader.remember(self.memory)
        self._reader.read(np.ones(self.num_worlds, bool), self._block_reader())
