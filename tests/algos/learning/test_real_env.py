"""Training in the simulator: evaluation on real tasks, and the same weights for any number of threads."""

import functools
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

import evogymcm as cm
from evogymcm.algos import Evaluation, PPOConfig, RunFolder, Trainer, evaluate, load_actor, make_actor
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


SEVERAL = replace(TINY, total_steps=1024, eval_starts=3, selection="robust")


def test_starts_of_evaluations_cost_env_steps_and_change_neither_training_nor_scores(tmp_path):
    plain = Trainer(make_short, replace(TINY, total_steps=1024)).train()
    folder = RunFolder(tmp_path / "run", asdict(SEVERAL))
    result = Trainer(make_short, SEVERAL).train(run=folder)
    assert _same(plain, result)
    assert result.eval_steps == 3 * plain.eval_steps
    for row, before in zip(result.rows, plain.rows, strict=True):
        kept = row.keys() - {"robust_score", "spread", "seconds"}
        assert {name: row[name] for name in kept} == {name: before[name] for name in kept}
    rows = [row for row in result.rows if "score" in row]
    assert result.best["robust"].item() == max(row["robust_score"] for row in rows)
    assert all(row["spread"] > 0 for row in rows)
    best = folder.load("best")
    assert best["score"].item() == best["row"]["score"]
    with Trainer(make_short, SEVERAL) as trainer:
        trainer.actor.load_state_dict(load_actor(best).state_dict())
        assert trainer.evaluate().robust == best["robust"].numpy()
    stopped = RunFolder(tmp_path / "stopped", asdict(SEVERAL))
    calls = []
    Trainer(make_short, SEVERAL).train(run=stopped, should_stop=lambda: calls.append(1) or len(calls) > 2)
    again = Trainer(make_short, SEVERAL).train(run=RunFolder(stopped.path, asdict(SEVERAL), resume=True))
    assert len(calls) == 3
    assert _same(result, again)
    assert again.best["robust"] == result.best["robust"]
    assert again.eval_steps == result.eval_steps


def _told(*starts):
    """An evaluation with these scores from the starts."""
    rows = np.array(starts, dtype=float)
    n = rows.shape[1]
    nothing = np.zeros(n, bool)
    unknown = np.full(n, np.nan)
    none = np.full((n, 4), np.nan)
    return Evaluation(rows[0], rows[0], np.ones(n, int), nothing, nothing, unknown, rows.size, rows, none)


@pytest.mark.parametrize("selection", ["score", "robust"])
@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_the_best_policy_is_the_one_of_the_selection(selection, sharing):
    """The first policy has the higher score, the second one is better from most starts; a third one is worse."""
    config = replace(SEVERAL, selection=selection, sharing=sharing)
    make = functools.partial(make_short, bodies=["Walk_Bot", "HHH/V.V"])
    with Trainer(make, config) as trainer:
        taken = []
        for scores in ([5.0, 1.0, 0.0], [4.0, 3.0, 3.5], [3.0, 3.0, 3.0]):
            with torch.no_grad():
                trainer.actor.log_std.add_(1.0)
            taken.append(trainer.take_best(_told(*([score, score] for score in scores))))
        assert taken == [True, selection == "robust", False]
        assert set(trainer.best["score"].tolist()) == {4.0 if selection == "robust" else 5.0}
        newest = trainer.actor.log_std - trainer.best["actor"]["log_std"]
        assert set(newest.flatten().tolist()) == {1.0 if selection == "robust" else 2.0}


def test_starts_that_no_evaluation_can_have_are_refused_before_training():
    two = functools.partial(make_short, bodies=["Walk_Bot", "HHH/V.V"])
    with pytest.raises(ValueError, match="eval_worlds: got 3, eval_starts 3 needs a multiple of 2 designs"):
        Trainer(two, replace(SEVERAL, eval_worlds=3))
    stream = functools.partial(make_short, bodies=lambda rng: cm.sample_body((3, 3), rng), grid_shape=(3, 3))
    with pytest.raises(ValueError, match="eval_starts: got 3, under a stream of bodies"):
        Trainer(stream, SEVERAL)
    with pytest.raises(ValueError, match=r"selection: got 'robust', .* needs eval_starts of at least 2"):
        PPOConfig(selection="robust")
    with pytest.raises(ValueError, match=r"advantage_scale: got 'world', .* needs rollout_steps of at least 2"):
        PPOConfig(advantage_scale="world", rollout_steps=1)


@pytest.mark.slow
@pytest.mark.usefixtures("small_batches_pay")
def test_threads_of_the_simulator_change_nothing():
    config = PPOConfig(total_steps=1024, num_worlds=32, rollout_steps=16, minibatch=256, hidden=16, eval_interval=0)
    runs = [Trainer(functools.partial(make_short, num_threads=threads), config).train() for threads in (1, 3)]
    assert _same(*runs)
