"""The six constructors take one list of options: the same names in the same order, with one default and one meaning."""

import inspect
import re

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
    described = re.findall(r"^ {8}(\w+): ", WorldOptions.__doc__ + EngineOptions.__doc__, re.MULTILINE)
    assert described == list(LIST)


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
        ({"num_threads": 0}, "num_threads: got 0"),
        ({"grid_shape": (2, 2)}, r"grid_shape: got \(2, 2\), at least \(2, 3\)"),
    ],
)
@pytest.mark.parametrize("constructor", CONSTRUCTORS)
def test_bad_options_are_named(constructor, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(constructor, **arguments)


def goals(made):
    return engine_of(made).memory["goals"].tolist()


def test_seeds_decide_what_is_drawn_and_zero_is_the_default():
    task = "BidirectionalWalker-v0"
    for constructor in SEEDED:
        drawn = goals(make(constructor, task))
        assert drawn == goals(make(constructor, task, seed=0)) != goals(make(constructor, task, seed=1))
    for constructor in SEEDED_AT_RESET:  # as Gymnasium asks: unseeded ones differ
        assert goals(make(constructor, task)) != goals(make(constructor, task))
        with pytest.raises(TypeError, match="seed"):
            make(constructor, task, seed=0)
