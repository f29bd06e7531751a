"""The documented example of a world, a task and a body of one's own."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import evogymcm as cm
from evogymcm.envs import TaskEngine
from evogymcm.envs.tasks.walking import Walking
from evogymcm.sim.constants import Physics
from tests.examples import EXAMPLES, load_example
from tests.registries import own_registries

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def example():
    with own_registries():
        yield load_example("custom_task")


def test_page_shows_the_example():
    assert (EXAMPLES / "custom_task.py").read_text().rstrip() in (ROOT / "docs" / "custom-tasks.md").read_text()


def test_custom_task_reaches_its_goal(example):
    engine = TaskEngine("Ascent-v0", "HHH/VVV", 2)
    engine.simulator.move("robot", (1.8, 0.4), 0)
    engine.refresh()
    engine.step(np.ones((2, 6)))
    assert engine.terminated.tolist() == [True, False]
    before, after = engine._reader.before, engine.snapshot
    expected = after.x - before.x + 3 * (after.y - before.y) + [1.0, 0.0]
    np.testing.assert_allclose(engine.reward, expected, atol=1e-15)


def test_id_cannot_be_taken_twice(example):
    task = cm.tasks["Ascent-v0"]
    assert cm.register_task(task) is task
    with pytest.raises(ValueError, match="Ascent-v0"):
        cm.register_task(Walking("Ascent-v0", example.STEPS, (1, 1), 10, ("relative",)))


def test_changed_physics_is_reported_and_acts():
    plain = gymnasium.make("evogymcm/DownStepper-v0", body="Walk_Bot")
    light = gymnasium.make("evogymcm/DownStepper-v0", body="Walk_Bot", physics=Physics(gravity=11.0))
    heights = []
    for env in (plain, light):
        env.reset(seed=0)
        _, _, _, _, info = env.step(np.ones(env.action_space.shape))
        heights.append(info["com"][1])
        assert ("physics" in info) == (env is light)
    assert info["physics"] == {"gravity": 11.0}
    assert heights[1] > heights[0]


def test_changed_physics_is_reported_for_many_worlds():
    env = gymnasium.make_vec("evogymcm/Walker-v0", num_envs=2, body="Walk_Bot", physics=Physics(friction=0.5))
    _, info = env.reset(seed=0)
    for told in (info, env.step(np.ones(env.action_space.shape))[-1]):
        assert told["physics"]["friction"].tolist() == [0.5, 0.5]


def test_physics_is_checked():
    with pytest.raises(ValueError, match="friction"):
        Physics(friction=-1.0)
    with pytest.raises(ValueError, match="substep"):
        Physics(substep=0.0)
    with pytest.raises(ValueError, match="gravity"):
        Physics(gravity=float("nan"))
    for value in (None, "strong", True, 1j, 10**400):
        with pytest.raises(ValueError, match=r"physics drag: got .*, expected a finite number at least 0"):
            Physics(drag=value)
    assert Physics(gravity=-3).gravity == -3.0
