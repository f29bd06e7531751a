"""Settings that are junk are refused with a ValueError that says so, whatever the junk is."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evogymcm.algos.codesign import (
    BodyPPOConfig,
    CodesignConfig,
    GeneticAlgorithm,
    HalvingSchedule,
    MapElites,
    RandomSearch,
    SearchConfig,
)
from evogymcm.algos.learning import PPOConfig, TrainConfig
from evogymcm.envs import (
    GymnasiumEnv,
    GymnasiumVectorEnv,
    SoftRobotEnv,
    TaskEngine,
    parallel_env,
    population_env,
    walking_task,
)
from evogymcm.envs.options import DEFAULTS
from evogymcm.sim.constants import Physics
from tests.envs.test_states import plain
from tests.properties.strategies import JUNK, tried


def moderate(junk):
    """Junk without numbers that ask for more memory than there is."""
    if isinstance(junk, list | tuple):
        return type(junk)(moderate(item) for item in junk)
    if isinstance(junk, np.ndarray):
        return junk if not np.issubdtype(junk.dtype, np.number) else junk.clip(-9, 9)
    return min(junk, 9) if isinstance(junk, int | float) and not isinstance(junk, bool) else junk


CONFIGS = (PPOConfig, BodyPPOConfig, CodesignConfig, SearchConfig, HalvingSchedule, TrainConfig, Physics)


@pytest.mark.parametrize("config", CONFIGS)
@given(JUNK, st.data())
def test_junk_in_settings_is_refused(config, junk, data):
    name = data.draw(st.sampled_from([field.name for field in fields(config) if field.init]))
    more = {"task": "Walker-v0", "bodies": "HH"} if config is TrainConfig else {}
    tried(config, **more | {name: junk})


@pytest.mark.parametrize("method", [GeneticAlgorithm, RandomSearch, MapElites])
@given(JUNK, st.data())
def test_junk_in_a_search_over_bodies_is_refused(method, junk, data):
    if method is MapElites:
        pytest.importorskip("ribs")
    names = ["shape", "budget", "population", "seed", "mutation_rate", "attempts", "weights", "carries_stiffness"]
    names += {GeneticAlgorithm: ["age_protection"], MapElites: ["initial", "dims", "probability", "sigma"]}.get(
        method, []
    )
    given_options = {"shape": (2, 2), "budget": 9, "population": 3, "seed": 0}
    tried(method, **given_options | {data.draw(st.sampled_from(names)): junk})


ENVIRONMENTS = {
    TaskEngine: ["task", "bodies", "num_worlds", "seed"],
    SoftRobotEnv: ["task", "bodies", "num_worlds", "seed"],
    population_env: ["task", "bodies", "copies", "num_bodies", "seed"],
    parallel_env: ["task", "bodies", "render_mode", "seed"],
    GymnasiumEnv: ["task", "body", "connections", "render_mode"],
    GymnasiumVectorEnv: [
        "task",
        "body",
        "num_envs",
        "connections",
        "autoreset_mode",
        "max_episode_steps",
        "render_mode",
    ],
}


@pytest.mark.parametrize("make", ENVIRONMENTS, ids=lambda make: make.__name__)
@given(JUNK, st.data())
def test_junk_in_an_environment_is_refused(make, junk, data):
    names = ENVIRONMENTS[make] + [name for name in DEFAULTS if name != "seed"]
    name = data.draw(st.sampled_from(names))
    if name in ("num_worlds", "num_envs", "copies", "grid_shape"):
        junk = moderate(junk)
    bodies = "body" if "body" in ENVIRONMENTS[make] else "bodies"
    tried(make, **{"task": "Walker-v0", bodies: "HV/S."} | {name: junk})


@given(JUNK, st.sampled_from(["step", "stiffness", "mask", "reset", "seed", "state"]))
def test_junk_given_to_an_engine_is_refused_and_changes_nothing(junk, what):
    engine = TaskEngine("Walker-v0", "HV/S.", 2, material="reactive", num_threads=1)
    before = plain(engine.state())
    ones = np.ones((2, 4))
    calls = {
        "step": lambda: engine.step(junk, ones),
        "stiffness": lambda: engine.step(ones, junk),
        "mask": lambda: engine.step(ones, ones, junk),
        "reset": lambda: engine.reset(junk),
        "seed": lambda: engine.set_seed(junk),
        "state": lambda: engine.set_state(junk),
    }
    if tried(lambda: (calls[what](), True)) is None:
        assert plain(engine.state()) == before


@given(JUNK, st.sampled_from(["spawn", "room", "time_limit", "observes", "floor", "id", "watches"]))
def test_junk_in_a_task_is_refused(junk, name):
    if name == "time_limit" and isinstance(junk, int):
        junk = min(junk, 9)

    def run():
        task = walking_task("Walker-v0", **{name: junk})
        return TaskEngine(task, "HV/S.", 1, num_threads=1)

    tried(run)
