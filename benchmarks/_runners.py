"""What the throughput benchmark runs: the library at each of its doors, and EvoGym in a process of its own.

A runner is made for one task and setting, and `run(seconds)` returns env-steps of all its worlds per second. Every one
takes random actions and starts ended episodes anew, and all of that counts.
"""

import json
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from evogymcm.body import Body
from evogymcm.envs import TaskEngine, as_task
from evogymcm.sim.simulator import Simulator
from evogymcm.sim.world import ROBOT, World, WorldObject

DOORS = ("core", "simulator", "gymnasium", "torchrl", "collector", "pettingzoo", "sb3")
_N_ACTIONS = 64  # different random actions, taken in turn
_CHUNK = 16  # env-steps between two looks at the clock


@dataclass(frozen=True)
class Workload:
    """What is simulated: a task, bodies dealt to the worlds in turn, worlds, threads and the material setting."""

    task: str
    bodies: tuple[Body, ...]
    worlds: int
    threads: int
    material: str
    seed: int = 0

    def make(self, kind: Callable[..., Any]) -> Any:
        """Returns an engine, or another environment that takes what an engine does."""
        options = {"material": self.material, "num_threads": self.threads, "seed": self.seed}
        return kind(self.task, list(self.bodies), self.worlds, **options)


class Runner:
    """Something that can be stepped over and over."""

    steps_at_once = 1  # env-steps that `advance` makes

    def advance(self) -> None:
        """Makes one step in every world, and resets those that have ended."""
        raise NotImplementedError

    def run(self, seconds: float) -> float:
        """Returns env-steps per second over at least so many seconds."""
        count, start = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - start) < seconds:
            for _ in range(_CHUNK):
                self.advance()
            count += _CHUNK
        return count * self.steps_at_once / elapsed

    def close(self) -> None:
        """Frees what the runner holds."""


def _random_actions(workload: Workload, shape: tuple[int, ...]) -> Any:
    """Returns an endless turn of actuations and stiffnesses (None in the invariant setting)."""
    rng = np.random.default_rng(workload.seed)
    actuation = rng.uniform(0.6, 1.6, (_N_ACTIONS, *shape))
    is_reactive = workload.material == "reactive"
    stiffness = rng.uniform(0.5, 2.0, (_N_ACTIONS, *shape)) if is_reactive else [None] * _N_ACTIONS
    return cycle(list(zip(actuation, stiffness, strict=True)))


class _Core(Runner):
    def __init__(self, workload: Workload) -> None:
        self.engine = workload.make(TaskEngine)
        self.actions = _random_actions(workload, self.engine.occupancy.shape)
        self.steps_at_once = workload.worlds

    def advance(self) -> None:
        self.engine.step(*next(self.actions))
        ended = self.engine.terminated | self.engine.truncated
        if ended.any():
            self.engine.reset(ended)


class _Simulator(Runner):
    """Physics alone: nothing is observed, episodes end by instability only or after the task's time limit."""

    def __init__(self, workload: Workload) -> None:
        task = as_task(workload.task)
        world = World.load(task.world)
        placed = [
            world.place(WorldObject(ROBOT, body.grid, task.spawn, body.connections)).simulation_order()
            for body in workload.bodies
        ]
        worlds = [placed[i % len(placed)] for i in range(workload.worlds)]
        self.simulator = Simulator(worlds, num_threads=workload.threads)
        self.actions = _random_actions(workload, (workload.worlds, self.simulator.n_cells))
        self.steps_at_once = workload.worlds
        self.length, self.limit = np.zeros(workload.worlds, np.int64), task.time_limit

    def advance(self) -> None:
        unstable = self.simulator.step(*next(self.actions))
        self.length += 1
        ended = unstable | (self.length >= self.limit)
        if ended.any():
            self.simulator.reset(ended)
            self.length[ended] = 0


class _Gymnasium(Runner):
    """`gymnasium.make` for one world, `make_vec` for more."""

    def __init__(self, workload: Workload) -> None:
        import evogymcm  # noqa: F401  registers the ids

        if len(workload.bodies) > 1:
            raise ValueError(
                "bodies: a Gymnasium vector environment holds one body; use the core, torchrl or collector"
            )
        name, options = f"evogymcm/{workload.task}", {"body": workload.bodies[0], "material": workload.material}
        self.is_single = workload.worlds == 1
        if self.is_single:
            self.env: Any = gymnasium.make(name, disable_env_checker=True, **options)
        else:
            self.env = gymnasium.make_vec(name, workload.worlds, num_threads=workload.threads, **options)
        box = self.env.action_space
        rng = np.random.default_rng(workload.seed)
        self.actions = cycle(list(rng.uniform(box.low, box.high, (_N_ACTIONS, *box.shape))))
        self.env.reset(seed=workload.seed)
        self.steps_at_once = workload.worlds

    def advance(self) -> None:
        _, _, terminated, truncated, _ = self.env.step(next(self.actions))
        if self.is_single and (terminated or truncated):
            self.env.reset()

    def close(self) -> None:
        self.env.close()


def _random_policy(workload: Workload, env: Any) -> Any:
    """Returns a policy that takes actions drawn before, in turn: it costs next to nothing."""
    import torch
    from tensordict import TensorDict
    from tensordict.nn import TensorDictModuleBase

    turn = _random_actions(workload, env.engine.occupancy.shape)
    names = ("actuation", "stiffness")
    actions = []
    for _ in range(_N_ACTIONS):
        parts = {n: torch.from_numpy(v).float() for n, v in zip(names, next(turn), strict=True) if v is not None}
        actions.append(TensorDict(parts, env.batch_size))

    class Policy(TensorDictModuleBase):
        """Writes the next action."""

        in_keys, out_keys = (), (("action", "actuation"),)

        def __init__(self) -> None:
            super().__init__()
            self.turn = cycle(actions)

        def forward(self, tensordict: Any) -> Any:
            return tensordict.set("action", next(self.turn))

    return Policy()


class _TorchRL(Runner):
    """`SoftRobotEnv.rollout`, 64 env-steps of every world at a time."""

    def __init__(self, workload: Workload) -> None:
        import torch

        torch.set_num_threads(workload.threads)
        self.env = _torchrl_env(workload)
        self.policy = _random_policy(workload, self.env)
        self.steps_at_once = _N_ACTIONS * workload.worlds

    def advance(self) -> None:
        self.env.rollout(_N_ACTIONS, self.policy, break_when_any_done=False)

    def run(self, seconds: float) -> float:
        return _run_batches(self, seconds)


class _Collector(Runner):
    """TorchRL's collector, 64 env-steps of every world at a time."""

    def __init__(self, workload: Workload) -> None:
        import torch
        from torchrl.collectors import Collector

        torch.set_num_threads(workload.threads)
        env = _torchrl_env(workload)
        self.steps_at_once = _N_ACTIONS * workload.worlds
        self.collector = Collector(
            env,
            _random_policy(workload, env),
            frames_per_batch=self.steps_at_once,
            total_frames=-1,
        )
        self.batches = iter(self.collector)

    def advance(self) -> None:
        next(self.batches)

    def run(self, seconds: float) -> float:
        return _run_batches(self, seconds)

    def close(self) -> None:
        self.collector.shutdown()


class _PettingZoo(Runner):
    """`parallel_env`, an agent a world."""

    def __init__(self, workload: Workload) -> None:
        from evogymcm.envs import parallel_env

        bodies = [workload.bodies[i % len(workload.bodies)] for i in range(workload.worlds)]
        options = {"material": workload.material, "num_threads": workload.threads, "seed": workload.seed}
        self.env = parallel_env(workload.task, bodies, **options)
        self.env.reset(seed=workload.seed)
        rng = np.random.default_rng(workload.seed)
        turn = []
        for _ in range(_N_ACTIONS):
            actions = {}
            for agent in self.env.possible_agents:
                boxes = self.env.action_space(agent).spaces
                actions[agent] = {n: rng.uniform(b.low, b.high).astype(b.dtype) for n, b in boxes.items()}
            turn.append(actions)
        self.actions = cycle(turn)
        self.steps_at_once = workload.worlds

    def advance(self) -> None:
        self.env.step(next(self.actions))
        if not self.env.agents:
            self.env.reset()


class _StableBaselines(Runner):
    """Stable-Baselines3's vector environment on the batched simulator."""

    def __init__(self, workload: Workload) -> None:
        self.env = self._make(workload)
        box = self.env.action_space
        rng = np.random.default_rng(workload.seed)
        shape = (_N_ACTIONS, workload.worlds, *box.shape)
        self.actions = cycle(list(rng.uniform(box.low, box.high, shape).astype(np.float32)))
        self.env.seed(workload.seed)
        self.env.reset()
        self.steps_at_once = workload.worlds

    def _make(self, workload: Workload) -> Any:
        from evogymcm.envs import SB3VecEnv

        options = {"material": workload.material, "num_threads": workload.threads}
        return SB3VecEnv(workload.task, workload.bodies[0], workload.worlds, **options)

    def advance(self) -> None:
        self.env.step(next(self.actions))

    def close(self) -> None:
        self.env.close()


class Subprocesses(_StableBaselines):
    """Stable-Baselines3's own `SubprocVecEnv`: a process for each world."""

    def _make(self, workload: Workload) -> Any:
        from stable_baselines3.common.vec_env import SubprocVecEnv

        def make() -> gymnasium.Env:
            import evogymcm  # noqa: F401  registers the ids

            return gymnasium.make(f"evogymcm/{workload.task}", body=workload.bodies[0], material=workload.material)

        return SubprocVecEnv([make] * workload.worlds)


def _run_batches(runner: Runner, seconds: float) -> float:
    """Returns env-steps per second of a runner whose `advance` is long enough to look at the clock after each."""
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        runner.advance()
        count += 1
    return count * runner.steps_at_once / elapsed


def _torchrl_env(workload: Workload) -> Any:
    from evogymcm.envs import SoftRobotEnv

    return workload.make(SoftRobotEnv)


_CLASSES = dict(
    zip(DOORS, (_Core, _Simulator, _Gymnasium, _TorchRL, _Collector, _PettingZoo, _StableBaselines), strict=True)
)


def make_runner(door: str, workload: Workload) -> Runner:
    """Returns a runner of the library through one of `DOORS`."""
    return _CLASSES[door](workload)


# Runs under an interpreter that has evogym: reads lines of seconds, writes lines of env-steps per second.
_EVOGYM = """
import itertools, json, os, sys, time
answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # the simulator greets on stdout
import gymnasium
import numpy as np
import evogym.envs

given = json.loads(sys.argv[1])
rng = np.random.default_rng(given["seed"])
envs = []
for body, connections in zip(given["bodies"], given["connections"]):
    options = {"body": np.array(body), "connections": np.array(connections)}
    env = gymnasium.make(given["task"], disable_env_checker=True, **options)
    env.reset(seed=given["seed"])
    envs.append((env, list(rng.uniform(0.6, 1.6, (64, *env.action_space.shape)))))
turn, step = itertools.cycle(envs), 0
print("ready", file=answers, flush=True)
for line in sys.stdin:
    seconds, count, start = float(line), 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        env, actions = next(turn)
        for _ in range(16):
            step += 1
            done = env.step(actions[step % 64])[2:4]
            if any(done):
                env.reset()
        count += 16
    print(count / (time.perf_counter() - start), file=answers, flush=True)
"""


class EvoGym(Runner):
    """EvoGym's own environment on the same task and bodies, one world after another, in its own process."""

    def __init__(self, python: Path, workload: Workload) -> None:
        given = {
            "task": workload.task,
            "seed": workload.seed,
            "bodies": [body.grid.tolist() for body in workload.bodies],
            "connections": [body.connections.tolist() for body in workload.bodies],
        }
        command: Sequence[str] = [str(python), "-c", _EVOGYM, json.dumps(given)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if self._answer() != "ready":
            raise RuntimeError(f"{python}: evogym could not be run there, see the messages above")

    def _answer(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def run(self, seconds: float) -> float:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{seconds}\n")
        self.process.stdin.flush()
        return float(self._answer())

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()
