"""Engines of drawn tasks, bodies and streams: resumed at any step, alone or beside others, all bits are equal."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import evogymcm as cm
from evogymcm.envs import TaskEngine
from tests.envs.test_states import plain
from tests.envs.tools import assert_same, outputs, slow_hull_area, slow_orientation, slow_window
from tests.properties.strategies import SEEDS, actions, bodies, fields, tasks, tried

GRID = (3, 4)


class Stream:
    """Draws small bodies, in the invariant setting some with a stiffness field."""

    def __init__(self, material):
        self.material = material

    def __call__(self, rng):
        body = cm.sample_body(rng.integers(1, 4, 2), rng)
        if self.material == "invariant" and rng.random() < 0.5:
            return body, rng.uniform(0.5, 2.0, body.shape)
        return body


@st.composite
def makers(draw, task=None, streams=True):
    """What makes engines that are all alike, but for the number of their threads and their seed."""
    task = draw(tasks() | st.sampled_from(sorted(cm.tasks))) if task is None else task
    material = draw(st.sampled_from(["invariant", "reactive"]))
    options = {
        "material": material,
        "grid_shape": GRID,
        "edge_rule": draw(st.sampled_from(["mean_factor", "mean_stiffness"])),
    }
    if draw(st.booleans()):
        options["physics"] = {"gravity": draw(st.floats(0.0, 200.0)), "friction": draw(st.floats(0.0, 2.0))}
    given, n = Stream(material), draw(st.integers(1, 4))
    if not (streams and draw(st.booleans())):
        given = draw(st.lists(bodies(3), min_size=1, max_size=3))
        if material == "invariant" and draw(st.booleans()):
            options["stiffness"] = [draw(st.none() | fields(body)) for body in given]

    def make(num_threads=1, seed=0, num_worlds=n):
        return TaskEngine(task, given, num_worlds, num_threads=num_threads, seed=seed, **options)

    return make


# What is done to an engine: a step or a reset, of all worlds or of some, or another seed.
DEEDS = st.tuples(st.sampled_from(["step", "step", "step", "reset", "seed"]), SEEDS, st.booleans())
DEEDS = st.lists(DEEDS, max_size=9)


def do(engine, deed):
    what, seed, of_all = deed
    rng, n = np.random.default_rng(seed), engine.num_worlds
    mask = None if of_all else rng.random(4)[:n] < 0.6
    if what == "seed":
        engine.set_seed(seed)
    elif what == "reset":
        engine.reset(mask)
    else:
        actuation, stiffness = actions((4, *engine.occupancy.shape[1:]), seed)
        engine.step(actuation[:n], stiffness[:n] if engine.material == "reactive" else None, mask)


def assert_equal(one, other):
    assert_same(outputs(one), outputs(other))
    assert one.bodies == other.bodies
    assert plain(one.state()) == plain(other.state())


@given(makers(), DEEDS, DEEDS, DEEDS, st.sampled_from([copy.deepcopy, lambda state: pickle.loads(pickle.dumps(state))]))
def test_an_engine_goes_on_from_any_state_in_any_other_engine(make, before, elsewhere, after, carry):
    engine, other = make(), make(seed=7)
    for deed in before:
        do(engine, deed)
    for deed in elsewhere:
        do(other, deed)
    state = engine.state()
    kept = plain(state)
    other.set_state(carry(state))
    assert_equal(engine, other)
    for deed in after:
        do(engine, deed)
        do(other, deed)
        assert_equal(engine, other)
    assert plain(state) == kept  # a copy: what is done later does not reach it
    engine.set_state(state)
    assert plain(engine.state()) == kept


@given(makers(), DEEDS, DEEDS, st.sampled_from([copy.deepcopy, lambda engine: pickle.loads(pickle.dumps(engine))]))
def test_a_copied_engine_goes_on_like_the_first(make, before, after, carry):
    engine = make()
    for deed in before:
        do(engine, deed)
    other = carry(engine)
    assert_equal(engine, other)
    for deed in after:
        do(engine, deed)
        shown = outputs(other)
        do(other, deed)
        assert_equal(engine, other)
        assert shown.keys()


@pytest.mark.usefixtures("small_batches_pay")
@given(makers(), DEEDS)
def test_threads_change_nothing(make, deeds):
    engine, other = make(), make(num_threads=3)
    for deed in deeds:
        do(engine, deed)
        do(other, deed)
    assert_equal(engine, other)
    other.close()


@given(makers(), DEEDS, st.integers(1, 3))
def test_the_first_worlds_do_not_depend_on_how_many_follow(make, deeds, fewer):
    engine, first = make(num_worlds=4), make(num_worlds=fewer)
    is_flat = engine.flat is not None
    for deed in [("reset", 0, True), *deeds]:
        do(engine, deed)
        do(first, deed)
        got, expected = outputs(engine), outputs(first)
        if not is_flat:
            expected.pop("flat", None)
        assert_same({name: values[:fewer] for name, values in got.items()}, expected)


@given(makers(), DEEDS)
def test_everything_shown_is_finite_and_in_its_range(make, deeds):
    engine = make()
    for deed in deeds:
        before = [engine.simulator.positions(world=world) for world in range(engine.num_worlds)]
        do(engine, deed)
        for name, values in outputs(engine).items():
            assert np.isfinite(values).all(), name
        if deed[0] == "step":
            for world in np.flatnonzero(engine.unstable):
                assert np.array_equal(engine.simulator.positions(world=int(world)), before[world])
            assert engine.terminated[engine.unstable].all()
        assert not (engine.reached & ~engine.terminated).any()
        assert (engine.length <= 9).all()
        assert ((engine.stiffness >= 0.5) & (engine.stiffness <= 2.0)).all()
        assert ((engine.actuation >= 0.6) & (engine.actuation <= 1.6)).all()


@given(tasks().flatmap(lambda task: st.tuples(st.just(task), makers(task))), DEEDS)
def test_readings_are_those_of_slow_twins(drawn, deeds):
    task, make = drawn
    engine = make()
    starts = {}
    for deed in deeds:
        if deed[0] == "seed":
            continue
        do(engine, deed)
        simulator, now = engine.simulator, engine.snapshot
        for world in range(engine.num_worlds):
            if engine.length[world] == 0:
                starts[world] = {o.name: simulator.positions(o.name, world) for o in simulator.objects(world)}
            for name, readings in [("robot", now.robot), *now.objects.items()]:
                points = simulator.positions(name, world)
                close(readings.com[world], points.mean(1))
                if world in starts:
                    angle = slow_orientation(starts[world][name], points)
                    # EvoGym's is rough where a point has hardly turned, and its sign is chance there.
                    assert abs(np.cos(angle) - np.cos(readings.orientation[world])) < 5e-5
                if name == "robot":
                    com = points.mean(1)
                    if task.reads_hull:
                        close(readings.hull_area[world], slow_hull_area(points))
            for window, seen, is_ceiling in ((task.floor, now.floor, False), (task.ceiling, now.ceiling, True)):
                if window is not None:
                    terrain = np.concatenate([simulator.positions(name, world) for name in window.objects], axis=1)
                    offsets = (terrain[0] - com[0]) / 0.1 + 0.5
                    if np.abs(offsets - np.round(offsets)).min() > 1e-9:  # else rounding says in which column one is
                        close(seen[world], slow_window(terrain, com, window.radius, is_ceiling))


def close(got, expected):
    np.testing.assert_allclose(got, expected, atol=1e-6)


class Failing:
    """A stream that gives something else than a body at one of its draws."""

    def __init__(self, bad, at):
        self.bad, self.left = bad, at

    def __call__(self, rng):
        self.left -= 1
        return self.bad if self.left == -1 else cm.sample_body((2, 2), rng)


@given(
    st.sampled_from(["HH.H", "R", None, 3, "HHHHH", (), ("HH", 3.0), ("HH", None), "no/such", b"HH", ["HH", 3]]),
    st.integers(0, 8),
    DEEDS,
)
def test_a_stream_that_fails_leaves_the_engine_as_it_was(bad, at, deeds):
    engine = tried(TaskEngine, "Walker-v0", Failing(bad, at), 3, grid_shape=(2, 2), num_threads=1)
    for deed in deeds if engine else []:
        before, shown = engine.state(), outputs(engine)
        if tried(lambda deed=deed: (do(engine, deed), True)) is None:
            assert_same(outputs(engine), shown)
            after = engine.state()
            for state in (before, after):
                state["stream"].pop("rngs")  # what was drawn is drawn
            assert plain(before) == plain(after)
            do(engine, ("step", 0, True))
            do(engine, ("reset", 0, True))
            return
