"""Training in the simulator: evaluation on real tasks, and the same weights for any number of threads."""

import functools
from dataclasses import replace

import pytest
import torch

import evogymcm as cm
from evogymcm.algos import PPOConfig, Trainer, evaluate, make_actor
from evogymcm.envs import SoftRobotEnv

TINY = PPOConfig(
    total_steps=4096, num_worlds=16, rollout_steps=16, epochs=2, minibatch=128, hidden=16, eval_interval=512
)
SHORT = replace(cm.tasks["Walker-v0"], time_limit=40)  # several episodes in a short run
make_short = functools.partial(SoftRobotEnv, SHORT, bodies="Walk_Bot", material="reactive", num_threads=1)
make_walker = functools.partial(SoftRobotEnv, "Walker-v0", bodies="Walk_Bot", material="reactive", num_threads=1)


def _weights(result) -> list[torch.Tensor]:
    return [value for net in (result.actor, result.critic) for value in net.state_dict().values()]


def _same(first, second) -> bool:
    return all(torch.equal(a, b) for a, b in zip(_weights(first), _weights(second), strict=True))


def test_untrained_policy_on_a_real_task():
    env = make_walker(num_worlds=2)
    result = evaluate(make_actor(env), env)
    assert result.length.tolist() == [500, 500]
    assert result.score[0] == result.score[1]
    assert abs(result.score[0]) < 1
    assert result.ceiling[0] == pytest.approx(9.55, abs=0.01)


@pytest.mark.parametrize("task", ["AreaMaximizer-v0", "CaveCrawler-v0"])
def test_tasks_with_and_without_a_ceiling(task):
    robot = {"AreaMaximizer-v0": "Amax_Bot", "CaveCrawler-v0": "Cave_Bot"}[task]
    env = SoftRobotEnv(task, bodies=robot, material="invariant", num_threads=1)
    result = evaluate(make_actor(env), env)
    assert ("fraction_of_ceiling" in result.summary()) == (task == "CaveCrawler-v0")


def test_evaluations_of_random_tasks_have_several_worlds_with_draws_of_their_own():
    task, given, draws = replace(cm.tasks["BidirectionalWalker-v0"], time_limit=3), [], []

    def make(*, num_worlds, seed):
        env = SoftRobotEnv(task, ["HH/HH", "HHH"], num_worlds, material="reactive", seed=seed, num_threads=1)
        env.reset()
        given.append((num_worlds, seed))
        draws.append({row.tobytes() for row in env.engine.memory["goals"]})
        return env

    with Trainer(make, TINY) as trainer:
        result = trainer.evaluate()
        trainer.evaluate()
        assert [worlds for worlds, _ in given] == [16, 16, 16]
        assert result.env_steps == 16 * 3
        assert trainer.eval_steps == 2 * result.env_steps
    with Trainer(make, replace(TINY, seed=1, eval_worlds=4)) as trainer:
        assert trainer.evaluate().env_steps == 4 * 3
    training, evaluation, again, other_training, other_evaluation = draws
    assert len(evaluation) == 16
    assert evaluation == again
    assert not evaluation & training
    assert not (training | evaluation) & (other_training | other_evaluation)


@pytest.mark.slow
@pytest.mark.usefixtures("small_batches_pay")
def test_threads_of_the_simulator_change_nothing():
    config = PPOConfig(total_steps=1024, num_worlds=32, rollout_steps=16, minibatch=256, hidden=16, eval_interval=0)
    runs = [Trainer(functools.partial(make_short, num_threads=threads), config).train() for threads in (1, 3)]
    assert _same(*runs)
