"""Set-up of all tests."""

import os

import pytest

# One torch thread, here and in the processes that tests start: more only fight over the cores. Where a test asks for
# more, idle ones otherwise spin, which slows the simulator's own threads down.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


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


@pytest.fixture
def sprint(tmp_path, monkeypatch):
    """The task's id, while it is registered; runs go to a folder of the test's own."""
    from tests.registries import Sprint, registered  # torch comes with it, after what is set above

    monkeypatch.chdir(tmp_path)
    observes = ("velocity", "orientation", "relative")
    task = Sprint("Sprint-v0", world="Walker-v0", spawn=(1, 1), time_limit=12, observes=observes)
    with registered(task) as name:
        yield name


@pytest.fixture
def sprint_baseline(sprint, tmp_path, monkeypatch):
    """The folder of a run of that task on random bodies, whose last policy is the package's only baseline."""
    from benchmarks.store_baseline import store
    from evogymcm.algos import PPOConfig, TrainConfig, train
    from evogymcm.algos import baselines as module

    ppo = PPOConfig(64, 4, 8, epochs=1, minibatch=16, hidden=8, context="attention", eval_worlds=2, seed=3)
    train(TrainConfig(sprint, random_bodies=(3, 2), stiffness=0.5, ppo=ppo), run=tmp_path / "universal", num_threads=1)
    monkeypatch.setattr(module, "FOLDER", tmp_path / "package")
    store(tmp_path / "universal", 2, module.FOLDER)
    return tmp_path / "universal"
