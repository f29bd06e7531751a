"""Independent runs on executors; those of processes are in test_workers.py."""

import functools
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import pytest

from evogymcm.algos import BodyPPOConfig
from evogymcm.algos.codesign import CodesignConfig, RayExecutor, codesign, codesign_all
from tests.algos.codesign.test_codesign import TINY as DASHING

# On a task of the package, which workers know without this file.
PPO = BodyPPOConfig(total_steps=128, num_worlds=8, rollout_steps=16, epochs=1, minibatch=64, hidden=8, eval_interval=0)
TINY = CodesignConfig("Thrower-v0", shape=(2, 3), population=3, budget=3, ppo=PPO)
CONFIGS = {f"seed{seed}": replace(TINY, seed=seed) for seed in range(2)}
SHORT = {name: replace(config, task=DASHING.task) for name, config in CONFIGS.items()}  # of this process


class Here(Executor):
    """Runs calls at once."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@functools.cache
def alone(seed, task):
    return codesign(replace(TINY, seed=seed, task=task)).rows


def check(executor, tmp_path, configs=CONFIGS):
    results = dict(codesign_all(configs, tmp_path, executor))
    expected = {name: alone(config.seed, config.task) for name, config in configs.items()}
    assert {name: result.rows for name, result in results.items()} == expected
    assert expected["seed0"] != expected["seed1"]


def test_runs_in_threads_are_those_of_one_after_another(tmp_path):
    with ThreadPoolExecutor(2) as executor:
        check(executor, tmp_path, SHORT)
    assert (tmp_path / "seed1" / "config.json").is_file()
    again = dict(codesign_all(SHORT, tmp_path, Here()))  # finished runs are only read
    assert all(result.finished for result in again.values())


def test_a_failed_run_is_raised(tmp_path):
    (tmp_path / "seed0").mkdir()
    (tmp_path / "seed0" / "something").touch()
    with pytest.raises(FileExistsError, match="not a run folder"):
        dict(codesign_all(SHORT, tmp_path, Here()))


@pytest.mark.slow
def test_a_ray_session_outlives_the_executors_that_use_it():
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=1, include_dashboard=False)
    try:
        for _ in range(2):
            with RayExecutor(address="auto") as executor:
                future = executor.submit(sorted, [2, 1])
            assert future.result() == [1, 2]
            assert ray.is_initialized()
        with RayExecutor() as executor:
            # One is under way, one has to wait. Ray interrupts Python code, but no long sleep.
            calls = [executor.submit(exec, "import time\nfor _ in range(60_000): time.sleep(0.01)") for _ in range(2)]
            executor.shutdown(cancel_futures=True)
            assert all(isinstance(call.exception(), ray.exceptions.TaskCancelledError) for call in calls)
    finally:
        ray.shutdown()
