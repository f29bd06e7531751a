"""Environments of all libraries show what an engine shows, and can be saved at any step."""

import io

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from evogymcm.envs import GymnasiumEnv, GymnasiumVectorEnv, SoftRobotEnv, TaskEngine, parallel_env, population_env
from tests.properties.strategies import SEEDS, actions, bodies, tasks
from tests.properties.test_engines import GRID, Stream

MATERIALS = st.sampled_from(["invariant", "reactive"])
DEEDS = st.lists(st.tuples(SEEDS, st.sampled_from(["step", "step", "step", "reset"])), max_size=12)


def flat_actions(space, n, seed):
    actuation, _ = actions((n, *space.shape), seed)
    return actuation


@given(tasks(), bodies(3), MATERIALS, st.integers(1, 3), st.sampled_from(list(AutoresetMode)), DEEDS, SEEDS)
def test_a_vector_environment_is_its_single_ones(task, body, material, n, mode, deeds, seed):
    options = {"material": material, "num_threads": 1}
    envs = GymnasiumVectorEnv(task, body, n, autoreset_mode=mode, **options)
    singles = [gymnasium.wrappers.TimeLimit(GymnasiumEnv(task, body, **options), task.time_limit) for _ in range(n)]
    got, info = envs.reset(seed=seed)
    expected = [env.reset(seed=seed + i) for i, env in enumerate(singles)]
    for i, (observation, told) in enumerate(expected):
        same(got[i], observation)
        same_info(info, told, i)
    ended = np.zeros(n, bool)
    for number, what in deeds:
        if what == "reset" or (mode == AutoresetMode.DISABLED and ended.any()):
            rng = np.random.default_rng(number)
            mask = ended | (rng.random(n) < 0.5)
            if not mask.any():
                continue
            got, info = envs.reset(options={"reset_mask": mask})
            for i in np.flatnonzero(mask):
                observation, told = singles[i].reset()
                same(got[i], observation)
                same_info(info, told, i)
            ended &= ~mask
            continue
        given = flat_actions(envs.single_action_space, n, number)
        got, reward, terminated, truncated, info = envs.step(given)
        for i, env in enumerate(singles):
            if mode == AutoresetMode.NEXT_STEP and ended[i]:
                observation, told = env.reset()
                step = observation, 0.0, False, False, told
            else:
                step = env.step(given[i])
            if mode == AutoresetMode.SAME_STEP and (step[2] or step[3]):
                same(info["final_obs"][i], step[0])
                same_info(info["final_info"], step[4], i)
                observation, told = env.reset()
                step = observation, *step[1:4], told
            same(got[i], step[0])
            assert (reward[i], terminated[i], truncated[i]) == step[1:4]
            same_info(info, step[4], i)
        ended = terminated | truncated if mode != AutoresetMode.SAME_STEP else np.zeros(n, bool)


def same(got, expected):
    np.testing.assert_array_equal(got, expected)


def same_info(info, told, world):
    for name, value in told.items():
        same(info[name][world], value)


def engine_and(make, task, given, n, **options):
    return TaskEngine(task, given, n, **options), make(task, given, n, **options)


def act(env, actuation, stiffness):
    """An action of SoftRobotEnv, as float64: what an engine takes, to the last bit."""
    parts = {"actuation": torch.from_numpy(actuation)}
    if env.engine.material == "reactive":
        parts["stiffness"] = torch.from_numpy(stiffness)
    return TensorDict({"action": TensorDict(parts, env.batch_size)}, env.batch_size)


@given(tasks(), st.lists(bodies(3), min_size=1, max_size=2) | st.none(), MATERIALS, st.integers(1, 4), DEEDS, DEEDS)
def test_a_torchrl_environment_is_its_engine_and_goes_on_from_a_file(task, given, material, n, before, after):
    options = {"material": material, "num_threads": 1, "grid_shape": GRID, "seed": 3}
    engine, env = engine_and(SoftRobotEnv, task, given or Stream(material), n, **options)
    other = SoftRobotEnv(task, given or Stream(material), n, **options)
    engine.set_seed(3)
    engine.reset()
    env.reset()
    for deeds in (before, after):
        for seed, what in deeds:
            actuation, stiffness = actions(engine.occupancy.shape, seed)
            mask = np.random.default_rng(seed).random(n) < 0.6
            mask[0] |= not mask.any()  # without any, TorchRL asks no environment
            if what == "reset":
                shown = env.reset(TensorDict({"_reset": torch.from_numpy(mask)[:, None]}, [n]))
                engine.reset(mask)
            else:
                shown = env.step(act(env, actuation, stiffness).set("_step", torch.from_numpy(mask)))["next"]
                engine.step(actuation, stiffness if material == "reactive" else None, mask)
                same(shown["reward"][:, 0], engine.reward.astype(np.float32))
                same(shown["done"][:, 0], engine.terminated | engine.truncated)
            rows = mask if what == "reset" else slice(None)  # TorchRL fills the others up from what it was given
            for name, values in engine.observations().items():
                same(shown[name][rows], values[rows])
            same(shown["return"][rows, 0], engine.returns[rows])
        file = io.BytesIO()
        torch.save(env.state_dict(), file)
        file.seek(0)
        other.reset()
        other.load_state_dict(torch.load(file, weights_only=True))
        env = other


@given(tasks(), st.lists(bodies(3), min_size=1, max_size=3), MATERIALS, DEEDS)
def test_a_pettingzoo_environment_is_its_engine(task, given, material, deeds):
    options = {"material": material, "num_threads": 1, "grid_shape": GRID, "seed": 3}
    env = parallel_env(task, given, **options)
    engine = TaskEngine(task, given, **options)
    engine.set_seed(3)
    for seed, what in [(0, "reset"), *deeds]:
        if what == "reset" or not env.agents:
            seen, _ = env.reset()
            engine.reset()
        else:
            live = [env.possible_agents.index(agent) for agent in env.agents]
            actuation, stiffness = actions(engine.occupancy.shape, seed)
            parts = (
                {"actuation": actuation, "stiffness": stiffness} if material == "reactive" else {"actuation": actuation}
            )
            given_actions = {env.possible_agents[i]: {name: values[i] for name, values in parts.items()} for i in live}
            mask = np.isin(np.arange(len(given)), live)
            engine.step(actuation, parts.get("stiffness"), mask)
            seen, reward, terminated, truncated, _ = env.step(given_actions)
            for i in live:
                agent = env.possible_agents[i]
                assert (reward[agent], terminated[agent], truncated[agent]) == (
                    engine.reward[i],
                    engine.terminated[i],
                    engine.truncated[i],
                )
            ended = engine.terminated | engine.truncated
            assert env.agents == [env.possible_agents[i] for i in live if not ended[i]]
        for agent, parts in seen.items():
            i = env.possible_agents.index(agent)
            for name, values in engine.observations().items():
                if name in parts:
                    same(parts[name], values[i])
            assert env.observation_space(agent).contains(parts)


@given(tasks(), st.lists(bodies(3), min_size=2, max_size=3), st.data(), DEEDS)
def test_groups_of_a_population_are_rows_of_its_worlds(task, given, data, deeds):
    names = [f"body_{i}" for i in range(len(given))]
    order = data.draw(st.permutations(names))
    cut = data.draw(st.integers(1, len(names)))
    groups = {"a": list(order[:cut])} | ({"b": list(order[cut:])} if order[cut:] else {})
    options = {"num_threads": 1, "grid_shape": GRID, "seed": 1}
    env, plain = population_env(task, given, 2, group_map=groups, **options), population_env(task, given, 2, **options)
    env.reset()
    plain.reset()
    for seed, _ in deeds:
        actuation = torch.from_numpy(actions((2, len(given), GRID[0] * GRID[1]), seed)[0])
        inputs = {
            group: {"action": {"actuation": actuation[:, [names.index(name) for name in members]]}}
            for group, members in groups.items()
        }
        grouped = TensorDict({g: TensorDict(v, [2, len(groups[g])]) for g, v in inputs.items()}, [2])
        got = env.step(grouped)["next"]
        whole = TensorDict({"bodies": TensorDict({"action": {"actuation": actuation}}, [2, len(given)])}, [2])
        expected = plain.step(whole)["next", "bodies"]
        for group, members in groups.items():
            rows = expected[:, [names.index(name) for name in members]]
            for key in ("task", "reward", "done", "voxels"):
                assert torch.equal(got[group, key], rows[key])
