"""`check_task`: it finds each mistake in a task of one's own, and none in those of the package."""

import random
from dataclasses import dataclass, replace

import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs import Window
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.world import World
from evogymcm.testing import check_task
from tests.envs.tools import SMALL, make_engine


@pytest.mark.parametrize("task", sorted(cm.tasks))
def test_tasks_of_the_package_have_no_mistakes(task):
    check_task(task)


def walking(**changes):
    return replace(Walking("Mine-v0", "Walker-v0", (1, 1), 500, ("velocity", "relative")), **changes)


SECOND_ROBOT = "object ground at 0 0\nFFFFFFFFFF\nobject helper at 5 1\nHS"
FIELDS = {
    "id": ({"id": " "}, "id: got ' '"),
    "spawn that is no cell": ({"spawn": (1.5, 1)}, r"spawn: got 1\.5, expected a whole number"),
    "spawn below the world": ({"spawn": (1, -1)}, "spawn: got -1"),
    "spawn of one number": ({"spawn": (1,)}, r"spawn: got \(1,\), expected a world cell"),
    "a long story": ({"about": "walk\nand walk"}, "about: got .*expected a few words in one line"),
    "no time": ({"time_limit": 0}, "time_limit: got 0, expected a whole number of at least 1"),
    "broken time": ({"time_limit": 1e3}, r"time_limit: got 1000\.0"),
    "unknown world": ({"world": "Waker-v0"}, "Waker-v0.*Walker-v0"),
    "nothing observed": ({"observes": ()}, "observes: got none"),
    "typo in observes": ({"observes": ("velocty",)}, "observes: got 'velocty', there is velocity, orientation"),
    "observes as text": ({"observes": "velocity"}, "observes: got 'velocity', expected a tuple"),
    "part twice": ({"observes": ("velocity", "velocity")}, "observes: got 'velocity' twice"),
    "floor without window": ({"observes": ("floor",)}, r"'floor' is not read; give the task floor=Window"),
    "object without watching": ({"observes": ("offset",)}, "observes: got 'offset'"),
    "part of an unknown object": (
        {"world": "Pusher-v0", "watches": ("ground", "package"), "observes": ("offset:pakage",)},
        "observes: got 'offset:pakage', there is .*offset:package",
    ),
    "window that is none": ({"floor": ("ground",)}, r"floor: got \('ground',\), expected a Window"),
    "window over nothing": ({"floor": Window(())}, "floor: objects: got none"),
    "window over text": ({"floor": Window("ground")}, "floor: objects: got 'ground', expected a tuple"),
    "window over an unknown object": ({"ceiling": Window(("roof",))}, "ceiling: objects: got 'roof', this world has"),
    "window of negative radius": ({"floor": Window(("ground",), -1)}, "floor: radius: got -1"),
    "unknown watched object": ({"watches": ("ball",)}, "watches: got 'ball', this world has robot, "),
    "watches as text": ({"watches": "package"}, "watches: got 'package', expected a tuple"),
    "watched twice": ({"world": "Pusher-v0", "watches": ("package",) * 2}, "watches: got 'package' twice"),
    "unknown object placed": ({"moves_at_reset": ("ball",)}, "moves_at_reset: got 'ball'"),
    "placed without a draw": ({"world": "Pusher-v0", "moves_at_reset": ("package",)}, "'offset' is None"),
    "a second robot": ({"world": World.from_picture(SECOND_ROBOT)}, "world: object 'helper' has actuators"),
    "the robot twice": ({"world": World.from_picture("object robot at 0 0\nFF")}, "object 'robot'"),
}


@pytest.mark.parametrize("case", FIELDS)
def test_mistakes_in_fields_are_named_when_an_engine_is_made(case):
    changes, message = FIELDS[case]
    task = walking(**changes)
    for make in (check_task, lambda task: make_engine(task, SMALL)):
        with pytest.raises(ValueError, match=f"(?s)^task '{task.id}': .*{message}"):
            make(task)


def method(name, function, **fields):
    """A task with another method."""
    kind = dataclass(frozen=True)(type("Mine", (Walking,), {name: function}))
    return kind("Mine-v0", "Walker-v0", (1, 1), 500, **{"observes": ("velocity",)} | fields)


def parts(function):
    def observation_parts(self, now):
        return Walking.observation_parts(self, now) | {"mine": function(now)}

    return method("observation_parts", observation_parts, observes=("mine",))


def endings(*ending):
    return method("endings", lambda self, after: iter([tuple(e(after) if callable(e) else e for e in ending)]))


def falls(after):
    return after.y < 0.0


METHODS = {
    "reward None": (method("reward", lambda self, a, b: None), r"reward: got None, expected numbers of shape \(3,\)"),
    "reward (N, 1)": (method("reward", lambda self, a, b: b.x[:, None]), r"reward: got float64 of shape \(3, 1\)"),
    "reward of one number": (method("reward", lambda self, a, b: 1.0), r"reward: got float64 of shape \(\)"),
    "reward of objects": (method("reward", lambda self, a, b: np.array([None] * len(b.x))), "reward: got object"),
    "ending (N, 1)": (endings(lambda after: falls(after)[:, None], 0.0), r"condition: got bool of shape \(3, 1\)"),
    "ending of numbers": (endings(lambda after: after.x, 0.0), "endings: condition: got float64"),
    "ending None": (endings(None, 0.0), "endings: condition: got None"),
    "ending alone": (endings(falls), "endings: got a tuple of 1"),
    "bonus None": (endings(falls, None), "endings: bonus: got None"),
    "bonus (N, 1)": (endings(falls, lambda after: after.x[:, None]), r"endings: bonus: got float64 of shape \(3, 1\)"),
    "goal by name": (endings(falls, 1.0, "fall"), "endings: is_goal"),
    "no endings": (method("endings", lambda self, after: None), "endings: got None"),
    "endings returned": (method("endings", lambda self, after: (falls(after), 0.0)), "endings: got ndarray"),
    "part of one row": (parts(lambda now: now.robot.com[0]), "'mine' is float64 of shape"),
    "part of a number": (parts(lambda now: 1.0), "'mine' is float64 of shape"),
    "part of text": (parts(lambda now: np.array(["a"] * len(now.x))), "'mine' is <U1"),
    "ceiling (N, 1)": (method("score_ceiling", lambda self, start: start.x[:, None]), "score_ceiling: got float64"),
    "draw of a list": (method("draw", lambda self, rng: [1]), "draw: got list"),
    "draw of text": (method("draw", lambda self, rng: {"a": "b"}), "draw: 'a' is <U1"),
    "draws of other shapes": (
        method("draw", lambda self, rng: {"a": np.zeros(rng.integers(1, 9))}),
        "draw: 'a' is float64 of shape .*, in an earlier draw float64",
    ),
    "draws of another kind": (
        method("draw", lambda self, rng: {"a": 0.5 if rng.random() < 0.5 else 1}),  # whole numbers first
        "draw: 'a' is float64 of shape .*, in an earlier draw int64",
    ),
    "draws of other names": (method("draw", lambda self, rng: {str(rng.random()): 1}), "draw: got .*, an earlier draw"),
    "memory that was not drawn": (
        method("remember", lambda self, after: {"steps": after.x}),
        "remember: got 'steps', `draw` has given nothing",
    ),
    "memory None": (method("remember", lambda self, after: None), "remember: got NoneType"),
}


@pytest.mark.parametrize("case", METHODS)
def test_mistakes_in_methods_are_named_when_an_engine_is_made(case):
    task, message = METHODS[case]
    for make in (check_task, lambda task: make_engine(task, SMALL, 3)):
        with pytest.raises(ValueError, match=f"^task 'Mine-v0': .*{message}"):
            make(task)


def test_memory_of_another_shape_is_named():
    @dataclass(frozen=True)
    class Mine(Walking):
        def draw(self, rng):
            return {"a": np.zeros(2)}

        def remember(self, after):
            return {"a": after.memory["a"][:, :1]}

    with pytest.raises(
        ValueError, match=r"remember: 'a' is float64 of shape \(3, 1\), expected float64 of shape \(3, 2\)"
    ):
        check_task(Mine("Mine-v0", "Walker-v0", (1, 1), 500, ("velocity",)))


def test_wrong_form_that_comes_later_is_named_in_its_step():
    task = method("reward", lambda self, a, b: b.x if a is b else b.x[:, None])
    engine = make_engine(task, SMALL, 3)
    with pytest.raises(ValueError, match=r"reward: got float64 of shape \(3, 1\)"):
        engine.step(np.ones((3, 6)))
    assert engine.returns.shape == (3,)


counter = iter(range(10**9))
LATE = {
    "global numpy generator": (
        method("draw", lambda self, rng: {"a": np.random.uniform()}),  # noqa: NPY002
        "draw: it uses a global generator",
    ),
    "global generator": (method("draw", lambda self, rng: {"a": random.random()}), "draw: it uses a global generator"),
    "generator of its own": (
        method("draw", lambda self, rng: {"a": np.random.default_rng().random()}),
        "the same seed",
    ),
    "rows of other worlds": (method("reward", lambda self, a, b: b.x - b.x.mean()), "'reward' differs in env-step 1"),
    "state of its own": (
        method("reward", lambda self, a, b: 0 * b.x + next(counter)),
        "'reward' differs in env-step 1",
    ),
    "first world in an observation": (parts(lambda now: now.x - now.x[0]), "'flat' differs in env-step 1"),
    "ending by the others": (
        endings(lambda after: after.x < after.x.max(), 0.0),
        "differs in env-step 1: world . alone shows",
    ),
    "not finite": (
        method("reward", lambda self, a, b: np.log(b.x - b.x - 1.0)),
        r"'reward' is \[nan, nan, nan\] in env-step 1",
    ),
}


@pytest.mark.parametrize("case", LATE)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_mistakes_that_show_late_are_named(case):
    task, message = LATE[case]
    make_engine(task, SMALL, 3)
    with pytest.raises(ValueError, match=f"^task 'Mine-v0': .*{message}"):
        check_task(task)
