"""The task engine: one batched implementation of every task, for all adapters.

Arrays are indexed by world and by cell of the padded grid (V cells, bodies in the upper left corner).
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np

from evogymcm._messages import brief
from evogymcm._settings import check_work_weight
from evogymcm.body import Body
from evogymcm.envs import checks
from evogymcm.envs.actions import checked_action
from evogymcm.envs.dealing import BodySpec, Start
from evogymcm.envs.episodes import Episodes
from evogymcm.envs.lineup import Lineup
from evogymcm.envs.observed import Observed
from evogymcm.envs.options import EngineOptions, as_physics, complete, lists_options
from evogymcm.envs.starts import Starts, checked_part_of
from evogymcm.envs.states import checked_arrays, checked_part
from evogymcm.envs.streams import BodySource, BodyStream, pack_bodies
from evogymcm.envs.task import Task
from evogymcm.envs.tasks import as_task
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW, STIFFNESS_HIGH, STIFFNESS_LOW
from evogymcm.sim.simulator import Simulator


class TaskEngine(Observed, Episodes):
    """N worlds of one task, each with its body, stepped and reset together.

    Args:
        task: A task or its id.
        bodies: A body or a list of n bodies (anything that `as_body` takes): world w has body w % n. Or a stream,
            from which a world gets a new body at each reset: `draw(rng)`, called with the world's own generator, which
            is made from its seed, or an iterator, which cannot be seeded or saved. In the invariant setting a stream
            may return (body, stiffness).
        num_worlds: N; as many as bodies by default, 1 with a stream.
        with_voxels: Whether to observe voxels (`self.voxels`).
        with_flat: Whether to compute the flat observation, which exists if all bodies are equal.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape, work_weight and seed, as all
            environments take them: see `EngineOptions`.

    Attributes:
        bodies: The body of each world.
        voxels: (N, V, F) float32 what voxels sense, see `voxels.py`.
        types: (N, V, 5) uint8 type codes of voxels and their neighbours, see `voxels.py`.
        flat: (N, D) the task's own observation, None where bodies differ.
        features: (N, G) COM velocity, sine and cosine of the orientation, and the task's own global parts.
        reward, terminated, truncated, unstable: (N,) of the last step.
        reached: (N,) bool, whether the last step ended the episode at a goal, see `Task.endings`.
        score: (N,) the sum of the episode's rewards without the last (the paper's score, once the episode has ended).
        returns: (N,) the sum of all rewards of the episode.
        length: (N,) env-steps of the episode.
        work: (N, 4) work of the episode, what actuation and stiffness supplied, then the net work of both; None where
            it is not measured, see `EngineOptions`. `works` has it by name.
        num_designs: How many bodies were given: world w holds design w modulo this. N with a stream.

    Raises:
        ValueError: For an unknown task, material or edge rule, a body that is invalid or does not fit, a stiffness
            that is not finite, out of range, of the wrong shape, or given in the reactive setting, and a task with
            mistakes, see `evogymcm.testing.check_task`. A reset raises it if a stream returns such a body, or ends.
    """

    @lists_options
    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec] | BodySource,
        num_worlds: int | None = None,
        *,
        with_voxels: bool = True,
        with_flat: bool = True,
        **options: Unpack[EngineOptions],
    ) -> None:
        task, chosen = as_task(task), complete(options)
        self.material = chosen["material"]
        lineup = Lineup(bodies, num_worlds, chosen)
        self._stream, self.num_designs = lineup.stream, lineup.num_designs
        self._start = Start(task)
        self._starts: Starts | None = None
        Episodes.__init__(self, task, lineup.num_worlds, check_work_weight(chosen["work_weight"]))
        self.set_seed(chosen["seed"])
        dealt, fields = lineup.deal()
        scenes = self._start.scenes(dealt)
        if self._stream is not None or len(set(dealt)) > 1:
            with checks.blaming(task):
                checks.check_windows(task)
        physics, num_threads = as_physics(chosen["physics"]), chosen["num_threads"]
        simulator = Simulator(
            scenes, chosen["edge_rule"], physics, num_threads, lineup.grid_shape, placed=task.moves_at_reset
        )
        Observed.__init__(self, task, simulator, dealt, lineup.grid_shape, with_voxels=with_voxels, with_flat=with_flat)
        n, v = self.occupancy.shape
        self.stiffness = np.ones((n, v)) if fields is None else fields
        self.actuation = np.ones((n, v))
        if fields is not None and self.material == "invariant":
            self.simulator.set_stiffness(self.stiffness)
        if self._stream is not None:
            self._stream.is_new[:] = True
        with checks.blaming(self.task):
            self.reset()
            checks.check_methods(self.task, self._reader.now)
        self.score_ceiling = self._ceiling()
        if self._stream is not None:
            self._stream.is_new[:] = True

    def _change_bodies(self, worlds: np.ndarray, bodies: Sequence[Body]) -> None:
        """Gives worlds other bodies, at reset and with stiffness 1."""
        robots = [self._start.robot(body) for body in bodies]
        for world, robot in zip(worlds.tolist(), robots, strict=True):
            self.simulator.set_robot(robot, world)
        self._show_bodies(worlds.tolist(), bodies)

    def _go_on(self, stream: BodyStream, chosen: np.ndarray) -> bool:
        """Gives the chosen worlds their next bodies, where the present one has begun an episode; returns if any had."""
        is_changed = chosen & ~stream.is_new
        worlds = np.flatnonzero(is_changed)
        given = stream.next(worlds)
        self._change_bodies(worlds, [body for body, _ in given])
        for world, (_, field) in zip(worlds.tolist(), given, strict=True):
            self.stiffness[world] = field
        if self.material == "invariant":
            self.simulator.set_stiffness(self.stiffness, is_changed)
        stream.is_new[chosen] = False
        return len(worlds) > 0

    def _ceiling(self) -> np.ndarray:
        """Returns (N,) the largest possible scores of episodes that begin with the present readings."""
        ceiling = self.task.score_ceiling(self._reader.now)
        return np.full(self.num_worlds, np.nan) if ceiling is None else np.array(ceiling, np.float64)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Starts new episodes in the worlds of the (N,) bool mask, in all by default."""
        chosen = np.ones(self.num_worlds, bool) if mask is None else checks.checked_mask(mask, self.num_worlds)
        has_changed = self._stream is not None and self._go_on(self._stream, chosen)
        self._draw(chosen)
        self.simulator.reset(chosen, self.memory["offset"] if self.task.moves_at_reset else None)
        if self._starts is not None:
            self._starts.move(self.simulator, np.flatnonzero(chosen).tolist())
        self.actuation[chosen] = 1.0
        if self.material == "reactive":
            self.stiffness[chosen] = 1.0
        self._begin(chosen)
        self._reader.remember(self.memory, chosen)
        self._renew_voxels(mask)
        self._reader.read(np.flatnonzero(chosen), 0)
        if has_changed:
            self.score_ceiling = np.where(chosen, self._ceiling(), self.score_ceiling)

    def step(self, actuation: np.ndarray, stiffness: np.ndarray | None = None, mask: np.ndarray | None = None) -> None:
        """Advances the worlds by one env-step; the results are in the attributes.

        Args:
            actuation: (N, V) actuation, clipped to [0.6, 1.6]; cells without an actuator have no effect.
            stiffness: (N, V) stiffness, clipped to [0.5, 2]: needed in the reactive setting, not allowed otherwise.
            mask: (N,) bool, the worlds to advance; all by default. The others stay as they are, and their
                actions are not checked.

        Raises:
            ValueError: For a wrong shape, or NaN at a voxel that uses the number.
        """
        actuators, occupancy = self.actuators, self.occupancy
        if mask is not None:
            mask = checks.checked_mask(mask, self.num_worlds)
            actuators, occupancy = actuators & mask[:, None], occupancy & mask[:, None]
        given = checked_action("actuation", actuation, actuators, ACTUATION_LOW, ACTUATION_HIGH)
        factors = None
        if stiffness is not None or self.material == "reactive":
            factors = self._checked_stiffness(stiffness, occupancy)
        work = None
        if self.work is not None:
            commands = given, self.stiffness if factors is None else factors
            work = self.simulator.command_work((self.actuation, self.stiffness), commands, mask)
        if mask is None:
            self.actuation = given
            self.stiffness = self.stiffness if factors is None else factors
        else:
            self.actuation[mask] = given[mask]
            if factors is not None:
                self.stiffness[mask] = factors[mask]
        if self._stream is not None:
            self._stream.is_new[True if mask is None else mask] = False
        reader = self._reader
        reader.turn()
        reader.remember(self.memory, mask)
        self._renew_voxels(mask)
        unstable = self.simulator.step(self.actuation, factors, mask, reader.read)
        if mask is not None:
            reader.keep(~mask)
        self._settle(reader.before, reader.now, unstable, mask)
        if work is not None:
            self._charge(work)

    def _checked_stiffness(self, stiffness: np.ndarray | None, occupancy: np.ndarray) -> np.ndarray:
        """Returns the stiffness of an action, see `checked_action`; ValueError where it is missing or not wanted."""
        if stiffness is None:
            raise ValueError(f"stiffness: the {self.material} setting needs stiffness in every action")
        if self.material != "reactive":
            raise ValueError(f"stiffness: the {self.material} setting takes no stiffness in its actions")
        return checked_action("stiffness", stiffness, occupancy, STIFFNESS_LOW, STIFFNESS_HIGH)

    def set_seed(self, seed: int | Sequence[int | None] | None) -> None:
        """Seeds random resets and streams: one seed a world, or one for the first, from which the others count up.

        None takes a seed from the operating system. It takes effect at the next reset.
        """
        seeds = checks.checked_seeds(seed, self.num_worlds)
        self._seed(seeds)
        if self._stream is not None:
            self._stream.set_seed(seeds)

    def stagger(self, seed: int = 0) -> None:
        """Spreads the ends of the present episodes evenly over the time limit, without simulating anything.

        Worlds that begin together end together, again and again: a learner would see one part of the episode at a time,
        and the bodies of a stream would change all at once. So each world's present episode counts as begun earlier
        than it was, and only the later ones are whole. Tasks without a time limit stay as they are.

        Args:
            seed: Of the order in which the worlds end.
        """
        limit = int(self._time_limit)
        if limit < np.iinfo(np.int64).max:
            order = np.random.default_rng(seed).permutation(self.num_worlds)
            self.length = order * limit // self.num_worlds

    def set_starts(self, starts: int, seed: int = 0) -> None:
        """Makes the worlds n = N / starts worlds several times over, from starts that differ by 1e-6 metres.

        World w is world w % n from start w // n, and draws what that one draws. Start 0 is the exact one; in the others
        each point of the robot is moved by normal noise of 1e-6 metres, which the seed and the start's number say.
        Nothing happens before the next reset. It is no part of the state; 1 undoes it, draws included. Seeds and states
        are set before, not in between.

        Raises:
            ValueError: The worlds are no such repetition, or get their bodies from a stream.
        """
        n = checked_part_of(starts, self.num_worlds, self.num_designs, is_stream=self._stream is not None)
        if self._starts is not None:
            self._rngs[self._starts.part :] = self._starts.rngs
        self._starts = Starts(n, self._rngs[n:], seed) if starts > 1 else None
        self._rngs[n:] = [copy.deepcopy(self._rngs[world % n]) for world in range(n, self.num_worlds)]

    def state(self) -> dict[str, Any]:
        """Returns a copy of everything that a step or a reset can change, for `set_state`.

        Raises:
            ValueError: Bodies come from an iterator, whose position cannot be saved.
        """
        stream = {}
        if self._stream is not None:
            stream = {"stream": self._stream.state() | {"bodies": pack_bodies(self.bodies)}}
            stream["stream"]["score_ceiling"] = self.score_ceiling.copy()
        return (
            stream
            | self._saved()
            | {
                "actuation": self.actuation.copy(),
                "stiffness": self.stiffness.copy(),
                "simulator": self.simulator.state(),
                "shown": {name: values.copy() for name, values in self._reader.now.memory.items()},
            }
        )

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restores a state of an engine that was made with the same arguments.

        Raises:
            ValueError: It belongs to another engine; then nothing has changed.
        """
        if not isinstance(state, Mapping):
            raise ValueError(f"state: got {brief(state)}, expected what `state()` has returned")
        checked = self._checked(state)
        checked |= checked_arrays(state, {"actuation": self.actuation, "stiffness": self.stiffness})
        shown, stream, robots = checked_arrays(state, self.memory, "shown"), self._stream, None
        if stream is not None:
            saved = checked_part(state, "stream")
            place, bodies = stream.checked(saved)
            checked |= checked_arrays(saved, {"score_ceiling": self.score_ceiling})
            robots = [self._start.robot(body) for body in bodies]
        elif "stream" in state:
            raise ValueError("state: it is of a stream of bodies, here bodies stay")
        self.simulator.set_state(checked_part(state, "simulator"), robots)
        self._take_up(checked)
        if stream is not None:
            stream.take_up(place)
            self._show_bodies(range(self.num_worlds), bodies)
        self.refresh()
        # The last observation was formed before the task's memory moved on.
        self._reader.remember(shown)

    def close(self) -> None:
        """Ends the simulator's threads; a later step starts them again."""
        self.simulator.close()

    def refresh(self) -> None:
        """Reads all worlds anew, after the simulator's state or the memory was changed from outside."""
        self._reader.remember(self.memory)
        self._renew_voxels(None)
        self._reader.read(np.arange(self.num_worlds), 0)
