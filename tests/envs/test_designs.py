"""Bodies and stiffness as they are given: the same forms mean the same to every environment."""

import gymnasium
import numpy as np
import pytest
import torch

from evogymcm import Body
from evogymcm.envs import SoftRobotEnv, TaskEngine, parallel_env, population_env
from evogymcm.envs.dealing import as_bodies

LEGS, BLOCK = Body("HHH/V.V"), Body("HH/VV")


def make_vec(task, body, **options):
    return gymnasium.make_vec(f"evogymcm/{task}", num_envs=2, body=body, **options)


def engine_of(env):
    env = getattr(env, "unwrapped", env)
    return getattr(env, "engine", env)


def texts(env):
    return [body.text for body in engine_of(env).bodies]


@pytest.mark.parametrize(
    "rows", [["HHH", "V.V"], ("HHH", "V.V"), ["333", "404"], np.array(["HHH", "V.V"]), LEGS.grid.tolist(), LEGS.grid]
)
def test_rows_are_one_body_to_every_environment(rows):
    assert texts(gymnasium.make("evogymcm/Walker-v0", body=rows)) == [LEGS.text]
    assert texts(make_vec("Walker-v0", rows)) == [LEGS.text] * 2
    for make in (SoftRobotEnv, TaskEngine, parallel_env, population_env):
        assert texts(make("Walker-v0", rows, num_threads=1)) == [LEGS.text]


@pytest.mark.parametrize(
    "several",
    [
        ["HHH/V.V", "HH/VV"],
        ["HHH/V.V", ["HH", "VV"]],
        [["HHH", "V.V"], ["HH", "VV"]],
        ["333\n404", BLOCK],
        (LEGS.grid, BLOCK.grid.tolist()),
        [torch.tensor(LEGS.grid), "HH/VV"],
    ],
)
def test_bodies_in_a_list_are_several(several):
    assert as_bodies(several) == [LEGS, BLOCK]


def test_one_row_is_a_body_beside_others():
    assert as_bodies(["HH", LEGS]) == [Body("HH"), LEGS]
    assert as_bodies(["HH", "HH/VV"]) == [Body("HH"), BLOCK]
    assert as_bodies(["Walk_Bot", "Cave_Bot"])[1].n_voxels == 12
    assert as_bodies(np.full((4, 2, 3), 3)) == [Body("HHH/HHH")] * 4
    assert as_bodies(["HH", "HH"]) == [Body("HH/HH")]


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([], "at least one"),
        (3, "expected a body or a list"),
        (None, "expected a body or a list"),
        (["HH", "HHH"], r"lengths \[2, 3\] .*one-row bodies are given as Body objects"),
        ([3, 3], "shape"),
        ([[3, 3], [3]], "equally long rows"),
        ([LEGS, 3], "shape"),
        (iter([LEGS, BLOCK]), "a stream, which .* take; a list is needed here"),
        (lambda rng: LEGS, "a stream, which .* take; a list is needed here"),
    ],
)
def test_what_is_no_body_is_refused(bodies, message):
    with pytest.raises(ValueError, match=message):
        as_bodies(bodies)


def test_stiffness_may_be_one_array_of_all_fields():
    bodies = [LEGS, Body("HHH/VRV"), LEGS]
    fields = np.random.default_rng(0).uniform(0.5, 2.0, (3, 2, 3))
    forms = [list(fields), fields, fields.tolist(), torch.tensor(fields)]
    for make in (SoftRobotEnv, TaskEngine, parallel_env, population_env):
        shown = [engine_of(make("Walker-v0", bodies, stiffness=form, num_threads=1)).stiffness for form in forms]
        np.testing.assert_array_equal(shown[0][1], fields[1].ravel())
        for other in shown[1:]:
            np.testing.assert_array_equal(other, shown[0])
    vector = gymnasium.make_vec("evogymcm/Walker-v0", num_envs=3, body=[LEGS] * 3, stiffness=fields)
    np.testing.assert_array_equal(vector.engine.stiffness[:, 0], fields[:, 0, 0])
    env = parallel_env("Walker-v0", bodies, num_threads=1)
    env.reset(options={"stiffness": fields})
    np.testing.assert_array_equal(env.engine.stiffness, shown[0])


@pytest.mark.parametrize("form", [np.asarray, np.ndarray.tolist, list, lambda field: field.astype(object)])
def test_stiffness_of_one_body_is_one_field_or_a_list_of_one(form):
    field = np.array([[0.5, 1.0, 2.0], [1.5, 1.0, 0.7]])
    for given in (form(field), [form(field)], field[None]):
        engine = TaskEngine("Walker-v0", LEGS, 2, stiffness=given, num_threads=1)
        np.testing.assert_array_equal(engine.stiffness, [field.ravel()] * 2)


@pytest.mark.parametrize(
    ("stiffness", "message"),
    [
        (np.ones((3, 2, 3)), r"got 3 fields, 2 bodies need as many: .*\(n, rows, cols\)"),
        (np.ones((2, 3)), "got 1 field, 2 bodies"),
        ([None], "got 1 field, 2 bodies"),
        (np.ones((2, 3, 2)), r"got shape \(3, 2\)"),
        ([None, np.full((2, 3), 3.0)], "from 1.0 to 3.0"),
        ([None, "soft"], "stiffness: expected equally long rows of numbers, got 'soft'"),
        (2.0, "got 1 field, 2 bodies"),
    ],
)
def test_stiffness_that_does_not_fit_the_bodies_is_refused(stiffness, message):
    with pytest.raises(ValueError, match=message):
        TaskEngine("Walker-v0", [LEGS, LEGS], stiffness=stiffness, num_threads=1)


def test_an_action_of_too_few_worlds_is_refused_with_both_shapes():
    three, one = (gymnasium.make_vec("evogymcm/Walker-v0", num_envs=n, body="Walk_Bot") for n in (3, 1))
    single = gymnasium.make("evogymcm/Walker-v0", body="Walk_Bot").unwrapped
    for env, shape, message in (
        (three, (2, 10), r"got shape \(2, 10\), expected \(3, 10\)"),
        (three, (3, 9), r"got shape \(3, 9\), expected \(3, 10\)"),
        (three, (10,), r"got shape \(10,\), expected \(3, 10\)"),
        (one, (10,), r"got shape \(10,\), expected \(1, 10\)"),
        (single, (9,), r"got shape \(9,\), expected \(10,\)"),
    ):
        env.reset(seed=0)
        with pytest.raises(ValueError, match=message):
            env.step(np.ones(shape))


def test_messages_about_many_large_bodies_are_short():
    large, many = Body(np.full((60, 60), 3)), [LEGS] * 300
    calls = [
        lambda: TaskEngine("Lifter-v0", Body(np.full((3, 60), 3)), num_threads=1),
        lambda: TaskEngine("Walker-v0", many, stiffness=np.full((300, 2, 3), 9.0), num_threads=1),
        lambda: population_env("Walker-v0", many, group_map={"all": [f"body_{i}" for i in range(299)]}),
        lambda: as_bodies(["HHH"] * 900 + ["HH"]),
        lambda: as_bodies([large, [*large.grid.tolist()[:-1], [3]]]),
        lambda: TaskEngine("Walker" * 90, LEGS),
        lambda: make_many().step({}),
        lambda: make_many().step({f"body_{i}": dict.fromkeys("abcdefghijklmnop" * 9, 1) for i in range(300)}),
    ]

    def make_many():
        env = parallel_env("Walker-v0", many, num_threads=1)
        env.reset()
        return env

    for call in calls:
        with pytest.raises(ValueError, match=r"\w") as error:
            call()
        assert len(str(error.value)) < 330, str(error.value)
