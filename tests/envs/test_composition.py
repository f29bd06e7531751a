"""What becomes of a world depends on no other, also where some end and start again while others go on."""

from dataclasses import fields

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import evogymcm as cm
from evogymcm.envs import GymnasiumVectorEnv, SoftRobotEnv, parallel_env, population_env
from tests.envs.tools import SMALL, make_engine

N, STEPS = 3, 7


def brief(task):
    """The task, with episodes that each end when they have drawn, at most after 3 steps, and observe how long it is."""
    base = type(task)

    def draw(self, rng):
        return base.draw(self, rng) | {"left": np.array(rng.integers(1, 5))}

    def remember(self, after):
        return dict(base.remember(self, after)) | {"left": after.memory["left"] - 1}

    def endings(self, after):
        yield from base.endings(self, after)
        yield after.memory["left"] <= 1, 0.5, True

    def observation_parts(self, now):
        return base.observation_parts(self, now) | {"left": now.memory["left"]}

    methods = (draw, remember, endings, observation_parts)
    kind = type("Brief", (base,), {method.__name__: method for method in methods})
    changes = {"id": "Brief-v0", "time_limit": 3, "observes": (*task.observes, "left")}
    return kind(**{field.name: getattr(task, field.name) for field in fields(task)} | changes)


class Alone:
    """Worlds that are simulated alone, each in an engine of its own: what they show, by world, episode and step."""

    def __init__(self, task):
        self.engines = [make_engine(task, SMALL, seed=world) for world in range(N)]
        for world, engine in enumerate(self.engines):
            engine.set_seed(world)
        self.episodes = [[] for _ in range(N)]

    def row(self, world, episode, step):
        while len(self.episodes[world]) <= episode:
            engine, number = self.engines[world], len(self.episodes[world])
            engine.reset()
            rows = [shown(engine)]
            while not (engine.terminated[0] or engine.truncated[0]):
                engine.step(action(world, number, len(rows))[None])
                rows.append(shown(engine))
            self.episodes[world].append(rows)
        return self.episodes[world][episode][step]


def shown(engine):
    """What one world shows."""
    names = ("flat", "features", "voxels", "com", "reward", "score", "returns", "terminated", "truncated", "reached")
    return {name: np.array(getattr(engine, name)[0]) for name in names}


def action(world, episode, step):
    """(V,) the action that leads to this step."""
    return np.random.default_rng((world, episode, step)).uniform(0.6, 1.6, 6)


class Batch:
    """Where each world of a batch is in its episodes."""

    def __init__(self, alone):
        self._alone, self._at = alone, np.zeros((N, 2), int)
        self.came_apart = False  # whether some worlds ended or stood still while others went on

    def actions(self):
        return np.stack([action(world, *(self._at[world] + [0, 1])) for world in range(N)])

    def step(self, going=None):
        going = np.ones(N, bool) if going is None else going
        self.came_apart |= not going.all()
        self._at[going, 1] += 1

    def restart(self, ended):
        self.came_apart |= 0 < ended.sum() < N
        self._at[ended, 0] += 1
        self._at[ended, 1] = 0

    def compare(self, worlds=range(N), **got):
        """Arrays by their names in the engine hold what these worlds show alone, bit for bit."""
        for i, world in enumerate(worlds):
            row = self._alone.row(world, *self._at[world])
            for name, values in got.items():
                value = np.asarray(values[i])
                expected = row[name].astype(value.dtype).reshape(value.shape)
                assert np.array_equal(value, expected), f"{name} of world {world}: {value}, alone {expected}"


def run_engine(task, batch):
    engine = make_engine(task, SMALL, N)
    engine.set_seed(0)
    engine.reset()

    def compare(*names):
        batch.compare(**{name: getattr(engine, name) for name in ("flat", "features", "voxels", "com", *names)})

    for _ in range(STEPS):
        engine.step(batch.actions())
        batch.step()
        compare("reward", "score", "returns", "terminated", "truncated", "reached")
        ended = engine.terminated | engine.truncated
        engine.reset(ended)
        batch.restart(ended)
        compare("returns", "terminated")


def run_vector(mode):
    def run(task, batch):
        env = GymnasiumVectorEnv(task, SMALL, N, autoreset_mode=mode, num_threads=1)
        actuators, ended = env.engine.actuators[0], np.zeros(N, bool)
        observation, _ = env.reset(seed=0)
        batch.compare(flat=observation)
        for _ in range(STEPS):
            observation, reward, terminated, truncated, info = env.step(batch.actions()[:, actuators])
            outcome = {"reward": reward, "terminated": terminated, "truncated": truncated}
            if mode == AutoresetMode.NEXT_STEP:
                batch.step(~ended)
                batch.restart(ended)
                batch.compare(flat=observation, **outcome, reached=info["reached"])
                ended = terminated | truncated
                continue
            ended = terminated | truncated
            batch.step()
            last = observation.copy()
            if mode == AutoresetMode.SAME_STEP:
                for world in np.flatnonzero(ended):
                    last[world] = info["final_obs"][world]
            batch.compare(flat=last, **outcome)
            if mode == AutoresetMode.DISABLED and ended.any():
                observation, _ = env.reset(options={"reset_mask": ended})
            batch.restart(ended)
            batch.compare(flat=observation)

    return run


def run_torchrl(make_env, *path):
    def run(task, batch):
        env = make_env(task)
        env.set_seed(0)
        state = env.reset()

        def compare(data, *names):
            found = {name: data[(*path, name)].numpy() for name in ("voxels", "com", *names)}
            found |= {"features": data[(*path, "task")].numpy(), "flat": data[(*path, "observation")].numpy()}
            batch.compare(**found, returns=data[(*path, "return")].numpy())

        compare(state)
        for _ in range(STEPS):
            state[(*path, "action", "actuation")] = torch.from_numpy(batch.actions())
            step, state = env.step_and_maybe_reset(state)
            batch.step()
            compare(step["next"], "reward", "score", "terminated", "truncated", "reached")
            batch.restart(step["next"][(*path, "done")].numpy()[:, 0])
            compare(state)

    return run


def run_parallel(task, batch):
    env = parallel_env(task, [SMALL] * N, num_threads=1)
    observations, _ = env.reset(seed=0)
    for _ in range(STEPS):
        live = np.array([agent in env.agents for agent in env.possible_agents])
        outcome = env.step({f"body_{i}": {"actuation": row} for i, row in enumerate(batch.actions())})
        batch.step(live)
        observations, rewards, terminations, _, infos = outcome
        worlds = np.flatnonzero(live)
        batch.compare(
            worlds,
            voxels=[observations[agent]["voxels"] for agent in observations],
            features=[observations[agent]["task"] for agent in observations],
            reward=list(rewards.values()),
            terminated=list(terminations.values()),
            returns=[info["return"] for info in infos.values()],
            reached=[info["reached"] for info in infos.values()],
        )
        if not env.agents:
            env.reset()
            batch.restart(np.ones(N, bool))


RUNS = {
    "engine": run_engine,
    **{f"vector {mode.name}": run_vector(mode) for mode in AutoresetMode},
    "SoftRobotEnv": run_torchrl(lambda task: SoftRobotEnv(task, SMALL, N, num_threads=1)),
    "population_env": run_torchrl(lambda task: population_env(task, [SMALL] * N, num_threads=1), "bodies"),
    "parallel_env": run_parallel,
}


def compare_with_alone(task, names):
    task = brief(task)
    alone = Alone(task)
    for name in names:
        batch = Batch(alone)
        try:
            RUNS[name](task, batch)
        except AssertionError as error:
            raise AssertionError(f"{name}: {error}") from error
        assert batch.came_apart, name


@pytest.mark.parametrize(("number", "task"), list(enumerate(sorted(cm.tasks))))
def test_worlds_show_what_they_show_alone(number, task):
    names = list(RUNS)
    compare_with_alone(cm.tasks[task], {names[number % len(names)], "engine"})  # every environment in its turn


@pytest.mark.slow
@pytest.mark.parametrize("task", sorted(cm.tasks))
def test_worlds_show_what_they_show_alone_in_every_environment(task):
    compare_with_alone(cm.tasks[task], RUNS)
