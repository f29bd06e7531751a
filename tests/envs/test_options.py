"""The six constructors take one list of options: the same names in the same order, with one default and one meaning."""

import importlib.util
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from evogymcm.envs import (
    BodiesParallelEnv,
    EngineOptions,
    GymnasiumEnv,
    GymnasiumVectorEnv,
    PopulationEnv,
    SoftRobotEnv,
    TaskEngine,
    WorldOptions,
)
from tests.envs.tools import SMALL

SEEDED = (TaskEngine, SoftRobotEnv, PopulationEnv, BodiesParallelEnv)
SEEDED_AT_RESET = (GymnasiumEnv, GymnasiumVectorEnv)
CONSTRUCTORS = SEEDED + SEEDED_AT_RESET
LIST = {
    "material": "invariant",
    "stiffness": None,
    "edge_rule": "mean_factor",
    "physics": None,
    "num_threads": None,
    "grid_shape": None,
    "work_weight": None,
    "seed": 0,
}


def taken(constructor):
    """Names and defaults of what a constructor takes by name only."""
    parameters = inspect.signature(constructor.__init__).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY}


def make(constructor, task="Walker-v0", body=SMALL, **options):
    return constructor(task, body, **options)


def engine_of(made):
    return getattr(made, "engine", made)


@pytest.mark.parametrize("constructor", CONSTRUCTORS)
def test_constructors_take_the_options_of_the_list(constructor):
    options = {name: default for name, default in LIST.items() if name != "seed" or constructor in SEEDED}
    assert list(taken(constructor).items())[: len(options)] == list(options.items())
    for name in options:
        assert re.search(rf"\boptions: (.*\n)?.*\b{name}\b", constructor.__doc__), name
    assert list(inspect.signature(constructor.__init__).parameters)[1:3] in (["task", "bodies"], ["task", "body"])


def test_each_option_is_described_once():
    assert list(EngineOptions.__annotations__) == list(LIST)
    texts = [inspect.cleandoc(options.__doc__) for options in (WorldOptions, EngineOptions)]  # Python 3.13 has them so
    described = re.findall(r"^ {4}(\w+): ", "\n".join(texts), re.MULTILINE)
    assert described == list(LIST)


def test_the_documentations_table_is_the_list_of_all_constructors():
    docs = Path(__file__).resolve().parents[2] / "docs"
    spec = importlib.util.spec_from_file_location("option_table", docs / "option_table.py")
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    assert set(page.CONSTRUCTORS.values()) == set(CONSTRUCTORS)
    assert f"{page.BEGIN}\n{page.table()}\n{page.END}" in page.PAGE.read_text(), "python docs/option_table.py --write"
    options, _ = page.table().split("\n\n")
    rows = re.findall(r"^\| `(\w+)` \| `(.*?)` \| .{20,} \|$", options, re.MULTILINE)
    assert dict(rows) == {name: repr(default) for name, default in LIST.items()}


@pytest.mark.parametrize("constructor", CONSTRUCTORS)
def test_options_mean_the_same_everywhere(constructor):
    field = np.full((2, 3), 0.7)
    given = {"stiffness": [field], "physics": {"gravity": 50.0}, "num_threads": 3, "grid_shape": (3, 4)}
    engine = engine_of(make(constructor, edge_rule="mean_stiffness", **given))
    assert engine.stiffness.reshape(3, 4)[:2, :3].tolist() == [[0.7, 0.7, 0.7], [0.7, 1.0, 0.7]]
    assert engine.simulator.physics.changed() == {"gravity": 50.0}
    assert engine.simulator.num_threads == 3
    assert engine.grid_shape == (3, 4)
    assert engine_of(make(constructor, material="reactive")).material == "reactive"
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'materiel'.*'material'"):
        make(constructor, materiel="reactive")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "Waker-v0"}, "Waker-v0.*Walker-v0"),
        ({"body": "H.H"}, "one piece"),
        ({"body": "RS"}, "actuator"),
        ({"body": [[3, 7]]}, "7"),
        ({"body": [[3, 3], [3]]}, "equally long rows"),
        ({"body": []}, "got none, at least one|shape"),
        ({"body": "Walk_Bott"}, "Walk_Bot"),
        ({"body": "H" * 12, "task": "AreaMaximizer-v0"}, "fit.*AreaMaximizer-v0"),
        ({"material": "active"}, "material: got 'active'.*invariant"),
        ({"edge_rule": "mean"}, "mean_factor"),
        ({"stiffness": np.full((2, 3), 2.1)}, r"2\.1.*0\.5 to 2"),
        ({"stiffness": np.full((2, 3), 0.4)}, r"0\.4.*0\.5 to 2"),
        ({"stiffness": np.full((2, 3), np.nan)}, "stiffness"),
        ({"stiffness": np.ones((3, 2))}, r"\(3, 2\).*\(2, 3\)"),
        ({"stiffness": np.ones((2, 3)), "material": "reactive"}, "reactive.*action"),
        ({"physics": {"mass": 1.0}}, r"physics: got \['mass'\], known are.*gravity"),
        ({"physics": 1.0}, r"physics: got 1\.0, expected Physics"),
        ({"num_threads": 0}, "num_threads: got 0"),
        ({"num_threads": True}, "num_threads: got True, expected a whole number"),
        ({"num_threads": []}, r"num_threads: got \[\], expected a whole number"),
        ({"grid_shape": (2, 2)}, r"grid_shape: got \(2, 2\), at least \(2, 3\)"),
    ],
)
@pytest.mark.parametrize("constructor", CONSTRUCTORS)
def test_bad_options_are_named(constructor, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(constructor, **arguments)


@pytest.mark.parametrize("seed", [2.5, -1, "7", {}, [2.5], [None, 1j], [0] * 3, True])
@pytest.mark.parametrize("constructor", SEEDED)
def test_bad_seeds_are_named(constructor, seed):
    with pytest.raises(ValueError, match="seed: got "):
        make(constructor, body=[SMALL, SMALL], seed=seed)


@pytest.mark.parametrize("number", [0, -1, 2.5, True, [], "2"])
@pytest.mark.parametrize(
    ("constructor", "name"),
    [
        (TaskEngine, "num_worlds"),
        (SoftRobotEnv, "num_worlds"),
        (PopulationEnv, "copies"),
        (PopulationEnv, "num_bodies"),
        (GymnasiumVectorEnv, "num_envs"),
    ],
)
def test_bad_counts_are_named(constructor, name, number):
    with pytest.raises(ValueError, match=f"{name}: got "):
        make(constructor, **{name: number})


def test_more_threads_than_worlds_cost_nothing():
    engine = make(TaskEngine, body=[SMALL, SMALL], num_threads=10**9)
    engine.step(np.ones((2, 6)))
    assert engine.length.tolist() == [1, 1]


@pytest.mark.parametrize("junk", [None, {}, 1j, "ones", [10**400], [[1.0], [1.0, 2.0]], b"1"])
def test_steps_and_states_that_are_no_numbers_are_named(junk):
    engine, vector = make(TaskEngine), make(GymnasiumVectorEnv)
    with pytest.raises(ValueError, match="actuation: got"):
        engine.step(junk)
    with pytest.raises(ValueError, match="action: got"):
        vector.step(junk)
    if not isinstance(junk, dict):
        with pytest.raises(ValueError, match="state: got"):
            engine.set_state(junk)


def goals(made):
    return engine_of(made).memory["goals"].tolist()


def test_equal_seeds_begin_with_the_same_episode_everywhere():
    task, drawn = "BidirectionalWalker-v0", []
    for constructor in CONSTRUCTORS[1:]:  # an engine's first episode begins when it is made
        made = make(constructor, task, **{"seed": 5} if constructor in SEEDED else {})
        made.reset(**{} if constructor in SEEDED else {"seed": 5})
        drawn.append(goals(made))
    assert drawn == [drawn[0]] * 5 == [goals(make(TaskEngine, task, seed=5))] * 5


def test_seeds_decide_what_is_drawn_and_zero_is_the_default():
    task = "BidirectionalWalker-v0"
    for constructor in SEEDED:
        drawn = goals(make(constructor, task))
        assert drawn == goals(make(constructor, task, seed=0)) != goals(make(constructor, task, seed=1))
    for constructor in SEEDED_AT_RESET:  # as Gymnasium asks: unseeded ones differ
        assert goals(make(constructor, task)) != goals(make(constructor, task))
        with pytest.raises(TypeError, match="seed"):
            make(constructor, task, seed=0)
