"""Independent runs on executors."""

from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import pytest

from evogymcm.algos import PPOConfig
from evogymcm.algos.codesign import CodesignConfig, codesign
from evogymcm.algos.parallel import RayExecutor, codesign_all
from evogymcm.envs import tasks

# On a task of the package, which workers know without this file.
PPO = PPOConfig(
    total_steps=128, num_worlds=8, rollout_steps=16, epochs=1, minibatch=64, hidden=8, eval_interval=0,
    sharing="independent",
)  # fmt: skip
TINY = CodesignConfig("Thrower-v0", shape=(2, 3), population=3, budget=3, ppo=PPO)
CONFIGS = {f"seed{seed}": replace(TINY, seed=seed) for seed in range(2)}


class Here(Executor):
    """Runs calls at once."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def check(executor, tmp_path):
    expected = {name: codesign(config).rows for name, config in CONFIGS.items()}
    results = dict(codesign_all(CONFIGS, tmp_path, executor))
    assert {name: result.rows for name, result in results.items()} == expected
    assert expected["seed0"] != expected["seed1"]


@pytest.fixture
def short_episodes(monkeypatch):
    monkeypatch.setitem(tasks._REGISTRY, "Thrower-v0", replace(tasks.as_task("Thrower-v0"), time_limit=20))


@pytest.mark.usefixtures("short_episodes")
def test_runs_are_those_of_one_after_another(tmp_path):
    check(Here(), tmp_path)
    assert (tmp_path / "seed1" / "config.json").is_file()
    again = dict(codesign_all(CONFIGS, tmp_path, Here()))  # finished runs are only read
    assert all(result.finished for result in again.values())


@pytest.mark.usefixtures("short_episodes")
def test_a_failed_run_is_raised(tmp_path):
    (tmp_path / "seed0").mkdir()
    (tmp_path / "seed0" / "something").touch()
    with pytest.raises(FileExistsError, match="not a run folder"):
        dict(codesign_all(CONFIGS, tmp_path, Here()))


@pytest.mark.slow
def test_processes(tmp_path):
    with ProcessPoolExecutor(2, get_context("spawn")) as executor:
        check(executor, tmp_path)


@pytest.mark.slow
def test_a_dask_cluster(tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        check(client.get_executor(), tmp_path)


@pytest.mark.slow
def test_a_ray_cluster(tmp_path):
    pytest.importorskip("ray")
    with RayExecutor(num_cpus=2, include_dashboard=False) as executor:
        check(executor, tmp_path)
