"""Set-up of all tests."""

import os
import shutil
from contextlib import contextmanager

import pytest

# One torch thread, here and in the processes that tests start: more only fight over the cores. Where a test asks for
# more, idle ones otherwise spin, which slows the simulator's own threads down.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("RAY_worker_niceness", "0")  # with Ray's 15, a loaded machine leaves its workers next to nothing


@pytest.fixture
def small_batches_pay(monkeypatch):
    """Threads are used for few worlds too."""
    from evogymcm.sim import _threads

    monkeypatch.setattr(_threads, "_PAYS", 1)


@pytest.fixture(name="own_registries")
def _own_registries():
    """Lets a test register tasks without the others seeing them."""
    from tests.registries import own_registries

    with own_registries():
        yield


@pytest.fixture
def headless(monkeypatch):
    """Windows open without a display."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@contextmanager
def sprinting():
    """Gives the task's id, while it is registered."""
    from tests.registries import Sprint, registered  # torch comes with it, after what is set above

    observes = ("velocity", "orientation", "relative")
    task = Sprint("Sprint-v0", world="Walker-v0", spawn=(1, 1), time_limit=12, observes=observes)
    with registered(task) as name:
        yield name


@pytest.fixture
def sprint(tmp_path, monkeypatch):
    """The task's id, while it is registered; runs go to a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    with sprinting() as name:
        yield name


@pytest.fixture(scope="session")
def trained_on_random_bodies(tmp_path_factory):
    """A folder with a run of that task, and with the baseline that it becomes, of which tests take copies."""
    from benchmarks.store_baseline import store
    from evogymcm.algos import PPOConfig, TrainConfig, train

    folder = tmp_path_factory.mktemp("baseline")
    ppo = PPOConfig(64, 4, 8, epochs=1, minibatch=16, hidden=8, context="attention", eval_worlds=2, seed=3)
    with sprinting() as name:
        config = TrainConfig(name, random_bodies=(3, 2), stiffness=0.5, ppo=ppo)
        train(config, run=folder / "universal", num_threads=1)
        store(folder / "universal", 2, folder / "package")
    return folder


@pytest.fixture
def sprint_baseline(trained_on_random_bodies, sprint, tmp_path, monkeypatch):
    """The folder of a run of that task on random bodies, whose last policy is the package's only baseline."""
    from evogymcm.algos import baselines as module

    shutil.copytree(trained_on_random_bodies, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(module, "FOLDER", tmp_path / "package")
    return tmp_path / "universal"
