"""The simulator's threads: forked processes get their own, and `close` ends them."""

import os
import subprocess
import sys
import threading

import gymnasium
import numpy as np
import pytest

from evogymcm.envs import SoftRobotEnv, parallel_env, population_env
from tests.envs.tools import SMALL, WIDE, assert_same, make_engine, outputs, step_randomly

MANY = 60  # worlds, which pay for two threads
FORK = """
import multiprocessing, sys
import numpy as np
from evogymcm.envs import TaskEngine

engine = TaskEngine("Walker-v0", ["HVH/S.R", "RHSV/H..H"], 60, num_threads=2)

def returns(action):
    engine.set_state(state)  # one process may be given both
    engine.step(np.full(engine.occupancy.shape, action))
    return engine.returns

engine.step(np.ones(engine.occupancy.shape))
state = engine.state()
with multiprocessing.get_context("fork").Pool(2) as pool:
    forked = pool.map_async(returns, [0.7, 1.4], chunksize=1).get(timeout=240)
for action, got in zip([0.7, 1.4], forked):
    assert np.array_equal(returns(action), got)
engine.close()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_engine_that_was_stepped_goes_on_in_forked_processes():
    done = subprocess.run([sys.executable, "-c", FORK], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


def workers():
    return [thread for thread in threading.enumerate() if thread.name.startswith("evogymcm")]


def test_closing_an_engine_ends_its_threads_and_a_step_starts_them_again():
    engine, other = (make_engine("Walker-v0", [SMALL, WIDE], MANY, num_threads=2) for _ in range(2))
    before = len(workers())
    step_randomly(engine, 2)
    assert len(workers()) == before + 1
    engine.close()
    engine.close()
    assert len(workers()) == before
    step_randomly(engine, 2)
    assert len(workers()) == before + 1
    engine.close()
    for _ in range(2):
        step_randomly(other, 2)
    assert_same(outputs(engine), outputs(other))
    other.close()
    assert len(workers()) == before


ENVIRONMENTS = {
    "vector": lambda: gymnasium.make_vec("evogymcm/Walker-v0", num_envs=MANY, body=SMALL, num_threads=2),
    "SoftRobotEnv": lambda: SoftRobotEnv("Walker-v0", [SMALL, WIDE], MANY, num_threads=2),
    "population_env": lambda: population_env("Walker-v0", [SMALL] * MANY, num_threads=2),
    "parallel_env": lambda: parallel_env("Walker-v0", [SMALL] * MANY, num_threads=2),
}


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_closing_an_environment_ends_its_threads(name):
    env = ENVIRONMENTS[name]()
    engine = getattr(env, "unwrapped", env).engine
    before = len(workers())
    engine.step(np.ones(engine.occupancy.shape))
    assert len(workers()) == before + 1
    env.close()
    assert len(workers()) == before
