"""A generation spread over workers: the same to the last bit, whatever their number and whoever dies."""

import functools
import os
import signal
import time
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import pytest
import torch

import evogymcm as cm
from evogymcm.algos import BodyPPOConfig, RunFolder, RunInUseError
from evogymcm.algos.codesign import CodesignConfig, RayExecutor, SearchConfig, codesign
from evogymcm.algos.codesign.codesigning import count_workers
from evogymcm.algos.codesign.crew import Crew
from evogymcm.algos.codesign.plan import pieces
from evogymcm.algos.codesign.workers import Workers
from tests.algos.codesign.test_codesign import Dash, told
from tests.algos.codesign.test_parallel import Here, check

PPO = BodyPPOConfig(total_steps=128, num_worlds=4, rollout_steps=16, epochs=1, minibatch=64, hidden=8, eval_interval=64)
SPREAD = CodesignConfig(  # every phase
    "Dash-v0",
    shape=(2, 3),
    population=3,
    budget=4,
    material="invariant",
    search=SearchConfig(rounds=2, acceptance="paper"),
    inherit=True,
    mutants=2,
    rungs=(0.5,),
    keep=(0.5,),
    piece=1,
    ppo=PPO,
    finetune_steps=64,
)
MINED = replace(SPREAD, task="Mined-v0", search=None, mutants=1, rungs=(), keep=())


@dataclass(frozen=True)
class Mined(Dash):
    """Kills the process that plays it while there is a file `mine`, which goes off once."""

    mine: str = ""

    def reward(self, before, after):
        try:
            Path(self.mine).unlink()
        except OSError:
            return super().reward(before, after)
        return os.kill(os.getpid(), signal.SIGKILL)


class Frail(Executor):
    """Runs calls at once; its workers die at so many of them before."""

    def __init__(self, deaths):
        self.deaths, self.calls = deaths, 0

    def submit(self, fn, /, *args, **kwargs):
        self.calls += 1
        if self.calls > self.deaths:
            return Here().submit(fn, *args, **kwargs)
        future = Future()
        future.set_exception(BrokenExecutor("gone"))
        return future


@pytest.fixture(scope="module")
def whole():
    return codesign(SPREAD, workers=1)


def is_same(result, other):
    weights = (result.policy["actor"], other.policy["actor"])
    return told(result) == told(other) and all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_a_run_is_the_same_on_an_executor_and_goes_on_with_other_workers(whole, tmp_path):
    seen = []
    with ThreadPoolExecutor(2) as threads:
        stopped = codesign(
            SPREAD,
            run=tmp_path / "run",
            executor=threads,
            progress=seen.append,
            should_stop=lambda: any(state.phase == "search" for state in seen),
        )
        assert not stopped.finished
        assert stopped.rows
        assert is_same(codesign(SPREAD, executor=threads), whole)
    assert is_same(codesign(SPREAD, run=tmp_path / "run", workers=1), whole)
    steps = [state.env_steps for state in seen]
    assert steps == sorted(steps)
    assert not list((tmp_path / "run").glob("pieces-*"))


def test_pieces_are_the_settings_not_the_workers():
    assert pieces(5, 2) == [slice(0, 2), slice(2, 4), slice(4, 6)]
    assert pieces(5, None) == [slice(0, 5)]
    long = CodesignConfig(population=8)  # of 3 million env-steps
    assert count_workers(replace(long, piece=2), 3) == 3
    assert count_workers(replace(long, piece=2), 9) == 4
    assert count_workers(long, 9) == 2  # pieces of four
    assert count_workers(replace(long, piece=None), 9) == 1
    assert count_workers(SPREAD, None) == 1  # a matter of seconds
    with pytest.raises(ValueError, match="workers: got 0, expected a whole number of at least 1"):
        codesign(SPREAD, workers=0)
    with pytest.raises(ValueError, match="workers: got 2 beside an executor"):
        codesign(SPREAD, workers=2, executor=Here())
    with pytest.raises(ValueError, match="executor: got 4, expected a"):
        codesign(SPREAD, executor=4)


def test_what_a_dying_worker_was_at_is_done_again_but_not_without_end():
    def piece(tell, should_stop):
        tell(3)
        return type("Found", (), {"env_steps": 5})

    seen = []
    done = Crew(Frail(2)).do([piece] * 2, seen.append, lambda: False)
    assert [found.env_steps for found in done] == [5, 5]
    assert seen[-1] == 10
    with pytest.raises(RuntimeError, match="3 workers died at the same piece"):
        Crew(Frail(9)).do([piece], seen.append, lambda: False)


def test_an_error_of_a_piece_is_raised_at_once():
    executor, calls = Frail(0), []

    def failing(tell, should_stop):
        calls.append(1)
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        Crew(executor).do([failing], print, lambda: False)
    assert executor.calls == 1


def test_a_piece_waits_for_a_former_worker_to_leave_its_folder(tmp_path):
    left = iter((True, False))

    def piece(tell, should_stop):
        if next(left):
            raise RunInUseError("still there")
        return type("Found", (), {"env_steps": 5})

    (found,) = Crew(Here(), tmp_path).do([piece], lambda steps: None, lambda: False)
    assert found.env_steps == 5


def test_worker_processes_outlive_errors_ctrl_c_and_each_other():
    with pytest.raises(RuntimeError, match="enough"), Workers(2) as workers:  # noqa: PT012
        died = workers.submit(os._exit, 3)
        with pytest.raises(BrokenExecutor, match="exit status 3"):
            died.result()
        first = workers.submit(os.getpid).result()
        workers.submit(signal.raise_signal, signal.SIGINT).result()
        workers.submit(print, "no answer").result()
        with pytest.raises(ValueError, match="'no'") as error:
            workers.submit(int, "no").result()
        assert "in worker process" in error.value.__notes__[0]
        assert workers.submit(pow, 2, 10).result() == 1024
        assert first != os.getpid()
        sleeping = workers.submit(time.sleep, 3600)
        while not sleeping.running():
            time.sleep(0.01)
        raise RuntimeError("enough")
    assert isinstance(sleeping.exception(), BrokenExecutor)


@functools.cache
def mined_alone():
    return codesign(MINED, workers=1)


def with_a_death(tmp_path, **options):
    """Runs MINED in a folder; a worker dies after the first updates of a training."""
    mine = tmp_path / "mine"
    task = Mined("Mined-v0", world="Walker-v0", spawn=(1, 1), time_limit=8, observes=("velocity",), mine=str(mine))
    cm.register_task(task, replace=True)
    laid = []

    def lay(state):
        if state.env_steps > 64 and not laid:
            laid.append(state)
            mine.touch()

    result = codesign(MINED, run=RunFolder(tmp_path / "run", {}), progress=lay, **options)
    assert laid
    assert not mine.exists()  # it went off
    assert is_same(result, mined_alone())


@pytest.mark.slow
def test_a_killed_process_costs_its_piece_only(tmp_path):
    with_a_death(tmp_path, workers=2)


# Each of these begins with whole runs side by side, so that its workers have to start but once.


@pytest.mark.slow
def test_a_broken_pool_ends_the_run_which_then_goes_on(tmp_path):
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        check(pool, tmp_path)
        with pytest.raises(BrokenExecutor):
            with_a_death(tmp_path, executor=pool)
    assert is_same(codesign(MINED, run=RunFolder(tmp_path / "run", {}, resume=True)), mined_alone())


@pytest.mark.slow
def test_a_killed_dask_worker_costs_what_its_threads_were_at_only(tmp_path):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        check(client.get_executor(pure=False), tmp_path)
        with_a_death(tmp_path, executor=client.get_executor(pure=False))


@pytest.mark.slow
def test_a_killed_ray_worker_costs_its_piece_only(tmp_path):
    ray = pytest.importorskip("ray")
    with RayExecutor(num_cpus=2, include_dashboard=False) as executor:
        check(executor, tmp_path)
        with_a_death(tmp_path, executor=executor)
        last = executor.submit(pow, 2, 10)
    assert last.done()  # shutting down waits
    assert last.result() == 1024
    assert not ray.is_initialized()
    with pytest.raises(RuntimeError, match="shut down"):
        executor.submit(pow, 2, 10)
