"""Watched objects of every kind, one or several: fixed, partly fixed, free, of one voxel; and windows over them."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs import Window
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.world import World
from tests.envs.tools import SMALL, assert_same, make_engine, outputs, step_randomly

# What EvoGym 2.0.0 reads at reset and after 20 env-steps of the actions below, metres and radians.
RECORDED = json.loads((Path(__file__).parents[1] / "data" / "watched.json").read_text())
MIXED = World.from_picture(
    """
    object ground at 0 0
    FFFFFFFFFFFF
    object peg at 6 1
    F
    object dot at 6 3
    S
    object net at 8 1
    FSSF
    F..F
    object shelf at 0 4
    FF
    .F
    """
)
WATCHING = {  # spawn, world, watched objects, objects under the floor and the ceiling window
    "bridge": ((2, 5), "BridgeWalker-v0", ("new_object_2",), ("new_object_2",), ()),
    "pusher": ((1, 1), "Pusher-v0", ("ground", "package"), ("ground", "package"), ()),
    "mixed": ((1, 1), MIXED, ("dot", "ground", "net", "peg", "shelf"), ("net", "peg", "dot"), ("shelf", "dot")),
}


def watching(case, **changes):
    spawn, world, watches, floor, ceiling = WATCHING[case]
    windows = {name: Window(objects) for name, objects in (("floor", floor), ("ceiling", ceiling)) if objects}
    return Walking("Watching", world, spawn, 99, ("velocity", *windows), **{"watches": watches} | windows | changes)


@pytest.mark.parametrize("case", WATCHING)
def test_objects_of_every_kind_are_read_as_in_evogym(case):
    engine = make_engine(watching(case), SMALL, 2)
    rng = np.random.default_rng(0)
    for step in range(21):
        for world, (name, expected) in [
            (world, item) for world in range(2) for item in RECORDED[case].get(str(step), {}).items()
        ]:
            if isinstance(expected, list):
                if step == 0:
                    continue  # the COM is at half a voxel, so that rounding decides which columns see what
                got = getattr(engine.snapshot, name)[world]
                np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11, err_msg=name)
                continue
            readings = engine.snapshot.objects[name]
            np.testing.assert_allclose(readings.com[world], expected["com"], rtol=0, atol=1e-12, err_msg=name)
            np.testing.assert_allclose(readings.velocity[world], expected["vel"], rtol=0, atol=1e-9, err_msg=name)
            turned = (readings.orientation[world] - expected["ort"] + math.pi) % (2 * math.pi) - math.pi
            assert abs(turned) < 0.005, name  # a cosine that rounds to more than 1 counts as 0.0045
            points = engine.simulator.positions(name, world) / 0.1  # as EvoGym's Python layer gets them
            np.testing.assert_array_equal(readings.low[world], (points * 0.1).min(1))
            np.testing.assert_array_equal(readings.high[world], (points * 0.1).max(1))
            center = points.cumsum(1)[:, -1:] / points.shape[1]  # one by one
            np.testing.assert_array_equal(readings.relative[world], (points - center) * 0.1)
        action = np.ones((2, 6))
        action[:, engine.actuators[0]] = rng.uniform(0.6, 1.6, 3)
        engine.step(action)


def test_bridge_is_observed_where_it_is():
    task = replace(cm.tasks["BridgeWalker-v0"], id="x", observes=("offset",), watches=("new_object_2",))
    np.testing.assert_allclose(make_engine(task, "Walk_Bot").flat, [[2.534, -0.457]], rtol=0, atol=5e-4)


def test_fixed_object_alone_is_read():
    # Its points are numbered after all moving ones: read as rows of those, they were foreign memory.
    task = replace(cm.tasks["Pusher-v0"], id="x", watches=("ground",))
    engine = make_engine(task, SMALL, 3)
    step_randomly(engine, 3)
    np.testing.assert_allclose(engine.snapshot.object.com, [[5.0, 0.05]] * 3, rtol=0, atol=1e-12)
    assert np.isfinite(engine.flat).all()
    wide = World.from_picture("\n".join(["F" * 1000] * 8))
    large = make_engine(replace(task, world=wide, spawn=(1, 8), observes=("offset",)), SMALL)
    np.testing.assert_allclose(large.flat + large.com, [[50.0, 0.4]], rtol=0, atol=1e-9)


def test_parts_of_each_watched_object_are_observed_by_name():
    names = ("ground", "package")
    parts = [f"{part}:{name}" for name in names for part in ("offset", "object_velocity", "object_orientation")]
    engine = make_engine(Walking("x", "Pusher-v0", (1, 1), 9, tuple(parts), watches=names), SMALL, 2)
    step_randomly(engine, 3)
    expected = []
    for readings in (engine.snapshot.objects[name] for name in names):
        expected += [readings.com - engine.com, readings.velocity, readings.orientation[:, None]]
    np.testing.assert_array_equal(engine.flat, np.concatenate(expected, axis=1))
    # Without a name it is the first.
    plain = make_engine("Pusher-v0", SMALL)
    first = make_engine(replace(cm.tasks["Pusher-v0"], id="x", watches=("package", "ground")), SMALL)
    named = replace(
        cm.tasks["Pusher-v0"],
        id="x",
        observes=("velocity", "offset:package", "object_velocity:package", "relative"),
    )
    named = make_engine(named, SMALL)
    for engine in (plain, first, named):
        step_randomly(engine, 5)
    assert np.array_equal(named.flat, plain.flat)
    assert_same(outputs(first), outputs(plain))


def test_two_watched_objects_of_which_none_is_observed():
    task = Walking("x", "Pusher-v0", (1, 1), 9, ("velocity", "relative"), watches=("ground", "package"))
    engine = make_engine(task, SMALL, 2)
    step_randomly(engine, 3)
    assert np.isfinite(engine.flat).all()


def test_watching_changes_no_other_number():
    plain = make_engine(watching("mixed", watches=()), SMALL, 2)
    all_watched = make_engine(watching("mixed"), SMALL, 2)
    for engine in (plain, all_watched):
        step_randomly(engine, 5)
    np.testing.assert_array_equal(plain.flat, all_watched.flat)
    np.testing.assert_array_equal(plain.voxels, all_watched.voxels)
