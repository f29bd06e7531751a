"""States that an engine refuses: it says why, and has changed nothing."""

import copy

import numpy as np
import pytest

import evogymcm as cm
from evogymcm import Body
from tests.envs.tools import SMALL, WIDE, assert_same, make_engine, outputs, random_actions


def draw(rng):
    return cm.sample_body((3, 3), rng), rng.uniform(0.5, 2.0, (3, 3))


def of_bodies(task, seed):
    return make_engine(task, [SMALL, WIDE], 3, seed=seed)


def of_a_stream(task, seed):
    return make_engine(task, draw, 3, seed=seed, grid_shape=(4, 4))


def plain(value):
    """A state as lists and bytes, which compare, with NaN too."""
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value.tobytes() if isinstance(value, np.ndarray) else value


def without(*path):
    def spoil(state):
        for name in path[:-1]:
            state = state[name]
        del state[path[-1]]

    return spoil


def with_other(value, *path):
    def spoil(state):
        for name in path[:-1]:
            state = state[name]
        state[path[-1]] = value(state[path[-1]]) if callable(value) else value

    return spoil


def fewer(values):
    return values[:-1]


LARGE = [[np.full((5, 5), 3, np.int8), Body(np.full((5, 5), 3)).connections]] * 3
EVERY = [
    (without("reward"), "it has no 'reward'"),
    (without("simulator"), "it has no 'simulator'"),
    (with_other(fewer, "terminated"), r"'terminated' has shape \(2,\), expected \(3,\)"),
    (with_other(fewer, "actuation"), "'actuation' has shape"),
    (with_other("far", "length"), "'length'"),
    (with_other(fewer, "simulator"), "it is not of 3 such worlds"),
    (with_other(fewer, "simulator", 2), "it is not of 3 such worlds"),
]
OF_CATCHER = [
    (with_other({}, "memory"), "'memory'"),
    (with_other(fewer, "memory", "offset"), "'offset' has shape"),
    (with_other({}, "shown"), "'shown'"),
    (with_other(fewer, "rngs"), "'rngs'"),
    (with_other({"bit_generator": "MT19937"}, "rngs", 1), "'rngs'"),
]
OF_STREAM = [
    (without("stream"), "it has no 'stream'"),
    (with_other(fewer, "stream", "rngs"), "'rngs'"),
    (with_other(fewer, "stream", "is_new"), "'is_new' has shape"),
    (with_other(fewer, "stream", "score_ceiling"), "'score_ceiling' has shape"),
    (with_other(fewer, "stream", "bodies"), "'bodies'"),
    (with_other(LARGE, "stream", "bodies"), "larger than grid_shape"),
    (with_other(lambda bodies: bodies[::-1], "stream", "bodies"), "it is not of 3 such worlds"),
]


@pytest.mark.parametrize(
    ("make", "task", "cases"),
    [
        (of_bodies, "Walker-v0", EVERY),
        (of_bodies, "Catcher-v0", EVERY + OF_CATCHER),
        (of_a_stream, "Walker-v0", EVERY + OF_STREAM),
        (of_a_stream, "Catcher-v0", EVERY + OF_CATCHER + OF_STREAM),
    ],
)
def test_a_state_that_is_refused_changes_nothing(make, task, cases):
    engine, twin, other = make(task, 1), make(task, 1), make(task, 2)
    actions, _ = random_actions(engine, 4)
    for each in (engine, twin, other):
        each.step(actions[0])
    other.step(actions[1])
    before, foreign = plain(engine.state()), other.state()
    for spoil, why in cases:
        state = copy.deepcopy(foreign)
        spoil(state)
        with pytest.raises(ValueError, match=why):
            engine.set_state(state)
        assert plain(engine.state()) == before
        assert_same(outputs(engine), outputs(twin))
    for action in actions[2:]:
        for each in (engine, twin):
            each.step(action)
            each.reset(np.array([True, False, False]))
        assert_same(outputs(engine), outputs(twin))


def test_a_state_of_a_stream_is_refused_where_bodies_stay():
    engine, other = of_bodies("Walker-v0", 1), of_a_stream("Walker-v0", 1)
    before = plain(engine.state())
    with pytest.raises(ValueError, match="state: "):
        engine.set_state(other.state())
    assert plain(engine.state()) == before
