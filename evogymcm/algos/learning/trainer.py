"""The learner of a run: rollouts, updates, evaluations, and all the state that resuming needs."""

import copy
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import Any, Self

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.record.loggers import Logger

from evogymcm.algos.learning.actor import make_actor
from evogymcm.algos.learning.bodies import N_HELD_OUT
from evogymcm.algos.learning.collector import WorldCollector
from evogymcm.algos.learning.config import PPOConfig
from evogymcm.algos.learning.critic import make_critic
from evogymcm.algos.learning.devices import find_device, on_cpu
from evogymcm.algos.learning.env import EnvFactory
from evogymcm.algos.learning.evaluation import Evaluation, draws_of, evaluate
from evogymcm.algos.learning.loop import Progress, TrainResult, train_to_the_end
from evogymcm.algos.learning.ppo import PPOLearner
from evogymcm.algos.learning.stacking import PerDesign, by_design, stack_states
from evogymcm.algos.learning.threads import exploration, limited_threads
from evogymcm.algos.learning.transfer import carried_over, check_form
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.envs.engines import engine_of


def _copies(config: PPOConfig, env: EnvBase) -> int | None:
    """Returns the number of sets of weights, None for shared ones."""
    if config.sharing == "shared":
        return None
    if getattr(env, "changes_bodies", False):
        raise ValueError(f"sharing: got {config.sharing!r}, a stream of bodies needs 'shared': no world keeps its body")
    for name in ("num_worlds", "eval_worlds"):
        value = getattr(config, name)
        if value is not None and value % env.num_designs:
            raise ValueError(f"{name}: got {value}, independent sharing needs a multiple of {env.num_designs} designs")
    return env.num_designs


class Trainer:
    """One training run in any `TrainingEnv`, as a whole (`train`) or update by update.

    As a context manager it closes its environment at the end.

    The run has a random generator of its own and leaves the global state of torch and TorchRL alone, so several runs
    can go on side by side in threads, each as if it were alone.

    Args:
        make_env: makes the training environment and a fresh one for each evaluation. Their seeds, made from the run's,
            differ.
        config: settings of the run.
        make_eval_env: makes the environments of evaluations if they differ, for example with bodies that training never
            sees.

    Raises:
        ValueError: Settings contradict each other, or this machine has no such device.
    """

    def __init__(self, make_env: EnvFactory, config: PPOConfig, make_eval_env: EnvFactory | None = None) -> None:
        self.make_env, self.config, self.make_eval_env = make_env, config, make_eval_env or make_env
        self.device = find_device(config.device)
        self.env_steps, self.eval_steps, self.seconds = 0, 0, 0.0
        self._is_fresh = True
        self.best: dict[str, Any] | None = None
        self.generator = torch.Generator().manual_seed(config.seed)
        # Worlds count up from a seed: those of training and evaluation, and of other runs, must not come near it.
        seed, self._eval_seed = np.random.SeedSequence(config.seed).generate_state(2).tolist()
        self._env = self._moved(make_env(num_worlds=config.num_worlds, seed=seed))
        self._is_open = True
        try:
            self._set_up(self._env)
        except BaseException:
            self._env.close(raise_if_closed=False)
            raise

    def _moved(self, env: EnvBase) -> EnvBase:
        """Returns the environment with its tensors on the device of the networks."""
        return env if self.device.type == "cpu" else env.to(self.device)

    def _set_up(self, env: EnvBase) -> None:
        """Makes the networks and what trains them."""
        config, copies = self.config, _copies(self.config, env)
        self.designs = env.num_designs
        is_stream = getattr(env, "changes_bodies", False)
        self._eval_worlds = config.eval_worlds or (N_HELD_OUT if is_stream else self.designs * draws_of(env.task))
        self._check_starts(env)
        options: dict[str, Any] = {"network": config.network, "copies": copies, "generator": self.generator}
        with limited_threads(config.torch_threads):
            self.actor = make_actor(env, config.hidden, config.initial_std, context=config.context, **options)
            self.critic = make_critic(env, config.hidden, **options)
        self.actor.to(self.device)
        self.critic.to(self.device)
        self.actor.noise_correlation, self.actor.generator = config.noise_correlation, self.generator
        self.policy = self.actor if copies is None else PerDesign(self.actor, copies)
        self.learner = PPOLearner(self.actor, self.critic, config, self.generator)
        with exploration(True):
            self.collector = WorldCollector(env, self.policy, config.frames_per_update)
        if is_stream:
            engine_of(env).stagger(self.config.seed)

    def _check_starts(self, env: EnvBase) -> None:
        """Raises a ValueError where an evaluation cannot have as many starts as the settings say."""
        starts = self.config.eval_starts
        if starts == 1 or self.make_eval_env is not self.make_env:  # `evaluate` looks at environments of its own
            return
        if getattr(env, "changes_bodies", False):
            raise ValueError(f"eval_starts: got {starts}, under a stream of bodies no two worlds are the same (1)")
        engine_of(env)
        if self._eval_worlds % self.designs:
            raise ValueError(
                f"eval_worlds: got {self._eval_worlds}, eval_starts {starts} needs a multiple of {self.designs} designs"
            )

    def train(
        self,
        *,
        run: RunFolder | None = None,
        progress: Callable[[Progress], None] | None = None,
        should_stop: Callable[[], bool] | None = None,
        initial: Mapping[str, Any] | None = None,
        logger: Logger | None = None,
    ) -> TrainResult:
        """Trains to the end, from the folder's checkpoint if any, closes the environment and returns the outcome.

        The arguments are those of the function `train`, which also writes the run's record.

        Raises:
            RunInUseError: Another process or thread works in the folder.
        """
        with self, run.lock() if run else nullcontext():
            if initial is not None:
                self.start_from(initial)
            return train_to_the_end(self, run=run, progress=progress, should_stop=should_stop, logger=logger)

    @property
    def is_finished(self) -> bool:
        """Whether all env-steps are done."""
        return self.env_steps >= self.config.total_steps

    def update(self) -> dict[str, float]:
        """Collects one rollout, learns from it, and returns a row for the table."""
        start = time.perf_counter()
        with exploration(True), limited_threads(self.config.torch_threads):
            rollout = self.collector.rollout()
            is_first = self._is_fresh and not self.env_steps
            if is_first:  # a fresh policy hardly depends on its inputs: they may be rescaled under it
                self._observe(rollout)
            begin, end = self.config.schedule
            done = begin + (end - begin) * self.env_steps / self.config.total_steps
            row = self.learner.update(rollout, 1 - done)
            if not is_first:  # after learning: the rollout's probabilities are those of the inputs' old scale
                self._observe(rollout)
        self.env_steps += rollout.numel()
        self.seconds += time.perf_counter() - start
        reward = rollout["next", "reward"].mean().item()
        return {"env_steps": self.env_steps, "seconds": self.seconds, "reward": reward, **row}

    def _observe(self, rollout: TensorDict) -> None:
        """Updates the running normalisation from a quarter of the rollout's steps, spread over it."""
        sample = rollout[:, ::4].select(*self.actor.in_keys)
        if self.actor.copies is not None:
            sample = by_design(sample, self.actor.copies)
        self.actor.observe(sample)
        self.critic.observe(sample)

    def evaluate(self) -> Evaluation:
        """Plays an episode in each world of a fresh environment, from each start, with the current policy."""
        start = time.perf_counter()
        starts = self.config.eval_starts
        env = self._moved(self.make_eval_env(num_worlds=starts * self._eval_worlds, seed=self._eval_seed))
        try:
            with limited_threads(self.config.torch_threads):
                result = evaluate(self.policy, env, starts, start_seed=self._eval_seed)
        finally:
            env.close(raise_if_closed=False)
        self.eval_steps += result.env_steps
        self.seconds += time.perf_counter() - start
        return result

    def policy_state(self) -> dict[str, Any]:
        """Returns the policy as it is saved: for the actor (`load_actor`), and to continue training from."""
        return {"form": self.actor.form, **self.learner.state_dict()}

    def take_best(self, evaluation: Evaluation) -> bool:
        """Keeps the current policy in `best` if it is the best so far, by `selection`; returns whether it is.

        A shared policy is judged by its mean over worlds. Independent ones are judged one by one: `best`
        may then hold policies from different moments.
        """
        state, by, copies = self.policy_state(), self.config.selection, self.actor.copies
        scores = {name: torch.from_numpy(getattr(evaluation, name)) for name in ("score", by)}
        if copies is not None:
            scores = {name: values.reshape(-1, copies).mean(0) for name, values in scores.items()}
        worth = scores[by]
        if self.best is None or (copies is None and worth.mean() > self.best[by].mean()):
            self.best = {name: copy.deepcopy(state[name]) for name in ("form", "actor", "critic")} | scores
            return True
        is_better = torch.zeros_like(worth, dtype=torch.bool) if copies is None else worth > self.best[by]
        if not is_better.any():
            return False
        for name in ("actor", "critic"):
            for key, values in state[name].items():
                self.best[name][key][is_better] = values[is_better]
        for name, values in scores.items():
            self.best[name] = torch.where(is_better, values, self.best[name])
        return True

    def start_from(self, policy: Mapping[str, Any]) -> None:
        """Starts from a saved policy's weights (see `train`) instead of fresh ones.

        One of another task or setting acts as before at first, see `carried_over`.

        Raises:
            ValueError: Its networks have another form.
        """
        policy = carried_over(policy, self._env)
        copies, given = self.actor.copies, policy["form"].get("copies")
        check_form(policy["form"], self.actor.form)
        for name, network in (("actor", self.actor), ("critic", self.critic)):
            weights = policy[name]
            if copies is not None and given is None:
                weights = stack_states([weights] * copies)
            network.load_state_dict(weights)
        if copies == given and "optimizer" in policy:
            self.learner.optimizer.load_state_dict(copy.deepcopy(policy["optimizer"]))  # it would go on in place
        self._is_fresh = False

    def state_dict(self) -> dict[str, Any]:
        """Returns all that is needed to resume: networks, optimiser, random state, live worlds, counters."""
        return {
            "learner": self.learner.state_dict(),
            "worlds": self.collector.state_dict(),
            "rng": self.generator.get_state(),
            "noise": on_cpu(self.actor.noise),
            "env_steps": self.env_steps,
            "eval_steps": self.eval_steps,
            "seconds": self.seconds,
            "best": self.best,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what `state_dict` returned."""
        self.learner.load_state_dict(state["learner"])
        self.collector.load_state_dict(state["worlds"])
        self.generator.set_state(state["rng"])
        self.actor.noise = None if state["noise"] is None else state["noise"].to(self.device)
        self.env_steps, self.eval_steps = state["env_steps"], state["eval_steps"]
        self.seconds, self.best = state["seconds"], state["best"]

    def close(self) -> None:
        """Closes the environment, with its threads; the networks are then on the CPU, like environments by default.

        From then on the actor takes its noise from torch's global generator.
        """
        if not self._is_open:
            return
        self._is_open = False
        self.collector.shutdown(close_env=False)
        self._env.close(raise_if_closed=False)  # TorchRL takes environments for closed that were never open
        self.actor.cpu()
        self.critic.cpu()
        self.actor.generator = self.actor.noise = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
