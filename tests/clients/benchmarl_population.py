# /// script
# requires-python = ">=3.11"
# dependencies = ["evogymcm[benchmarl]"]
# ///
"""BenchMARL: IPPO and MAPPO over a population of bodies, an experiment that is saved and goes on, reproducible."""

import tempfile
from dataclasses import replace

import numpy as np
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

import evogymcm as cm
from evogymcm.envs import BenchMARLTask

TASK = replace(cm.tasks["AreaMaximizer-v0"], time_limit=20)
BODIES = ["HHH/V.V", "VVV/H.H", "HV/VH"]
WORLDS, STEPS = 8, 40  # of the population, and of a batch


class Returns(Callback):
    """Notes the mean return of each evaluation."""

    def __init__(self):
        super().__init__()
        self.means = []

    def on_evaluation_end(self, rollouts):
        assert len(rollouts) == 2
        assert all(rollout["next", "done"].nonzero()[0, 0] == TASK.time_limit - 1 for rollout in rollouts)
        rewards = np.stack([rollout["next", "bodies", "reward"][: TASK.time_limit] for rollout in rollouts])
        assert rewards.shape == (2, TASK.time_limit, len(BODIES), 1)
        assert np.isfinite(rewards).all()
        self.means.append(rewards.sum(1).mean())


def make_experiment(algorithm, folder, updates=12, **settings):
    config = ExperimentConfig.get_from_yaml()
    config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = WORLDS, WORLDS * STEPS
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 5, 80
    config.max_n_iters, config.max_n_frames, config.lr = updates, None, 1e-3
    config.evaluation_interval, config.evaluation_episodes = 4 * WORLDS * STEPS, 2
    config.loggers, config.render, config.save_folder, config.checkpoint_at_end = [], False, folder, True
    config.share_policy_params = False  # a policy for each body
    for name, value in settings.items():
        setattr(config, name, value)
    return Experiment(
        task=BenchMARLTask(TASK, BODIES),
        algorithm_config=algorithm.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
        callbacks=[Returns()],
    )


def run(algorithm, folder, **settings):
    """Returns the mean return of each evaluation, and the file of the experiment."""
    experiment = make_experiment(algorithm, folder, **settings)
    experiment.run()
    (saved,) = experiment.folder_name.glob("checkpoints/*.pt")
    return experiment.callbacks[0].means, saved


def main():
    with tempfile.TemporaryDirectory() as folder:
        for algorithm in (IppoConfig, MappoConfig):
            means, saved = run(algorithm, folder)
            assert means[-1] > means[0] + 0.05, f"{algorithm.__name__}: mean returns {means}"
        shared = [
            run(MappoConfig, folder, updates=2, evaluation_interval=WORLDS * STEPS, share_policy_params=True)[0]
            for _ in range(2)
        ]
        assert shared[0] == shared[1], "one seed gave two runs"
        again = Experiment.reload_from_file(str(saved), {"max_n_iters": 13})
        assert again.task.config["bodies"] == [cm.as_body(body) for body in BODIES]
        again.run()
        assert again.n_iters_performed == 13


if __name__ == "__main__":
    main()
