"""Work in processes of their own: it goes on, stops, is found again, dies and is resumed, and loses nothing."""

import time

import numpy as np
import pytest

from evogymcm.algos import PPOConfig, load_policy
from evogymcm.studio.learning import Learning
from evogymcm.studio.player import Player

BODY = "HHH/V.V"
FIELD = np.linspace(0.5, 2, 6).reshape(2, 3)
PPO = PPOConfig(total_steps=4096, num_worlds=4, rollout_steps=32, minibatch=64, eval_interval=512, epochs=1, hidden=4)


def wait_for(condition, seconds=300):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.05)
    return found


@pytest.mark.slow
def test_a_training_runs_stops_is_found_again_and_goes_on(tmp_path):
    folder = tmp_path / "run"
    learning = Learning(folder, BODY, FIELD, ppo=PPO)
    assert learning.status()["state"] == "new"
    learning.start()
    assert learning.status()["state"] == "running"
    wait_for(lambda: learning.status()["env_steps"] >= 512)
    found = Learning.open(folder)  # as after a restart of the server
    assert found.status()["state"] == "running"
    player = Player(BODY, FIELD, policy=found.policy)  # what there is so far
    player.step(3)
    assert found.stop(30)
    status = found.status()
    assert (status["state"], status["error"], status["total"]) == ("stopped", None, 4096)
    assert 512 <= status["env_steps"] < 4096
    assert learning.status() == status
    found.resume()
    wait_for(lambda: not found.is_running)
    done = found.status()
    assert (done["state"], done["env_steps"]) == ("finished", 4096)
    assert done["curve"][: len(status["curve"])] == status["curve"]
    assert load_policy(folder).path.name == "final.pt"
