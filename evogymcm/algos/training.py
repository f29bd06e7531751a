"""The training loop: rollouts, updates, evaluations, checkpoints."""

import copy
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.record.loggers import Logger

from evogymcm.algos.actor import Actor, make_actor
from evogymcm.algos.critic import Critic, make_critic
from evogymcm.algos.evaluate import Evaluation, evaluate
from evogymcm.algos.ppo import PPOConfig, PPOLearner
from evogymcm.algos.runs import RunFolder, stop_on_interrupt
from evogymcm.algos.sharing import PerDesign, by_design, stack_states

__all__ = ["EnvFactory", "Progress", "TrainResult", "Trainer", "train"]

CHECKPOINT, BEST, FINAL = "checkpoint", "best", "final"


class EnvFactory(Protocol):
    """Makes environments, e.g. `functools.partial(SoftRobotEnv, "Walker-v0", bodies=body)`."""

    def __call__(self, *, num_worlds: int, seed: int) -> EnvBase:
        """Returns a fresh environment, batch size (num_worlds,)."""


@dataclass(frozen=True)
class Progress:
    """State of a run, given to the caller after every update.

    Attributes:
        env_steps: done so far, in all worlds together.
        total_steps: of the whole run.
        seconds: spent so far, earlier sittings of a resumed run included.
        row: newest row of the table: losses, mean reward, and scores where there was an evaluation.
    """

    env_steps: int
    total_steps: int
    seconds: float
    row: dict[str, float]


@dataclass(frozen=True)
class TrainResult:
    """Outcome of a run.

    Attributes:
        actor: the last policy.
        critic: the last value function.
        rows: the table, one row per update and one, with `env_steps` 0, for the untrained policy.
        final: evaluation of the last policy; None if the run was stopped.
        env_steps: done in all worlds together.
        eval_steps: env-steps simulated in evaluations, which `env_steps` leaves out.
        seconds: wall time of training and evaluations.
        finished: False if the run was stopped before its end.
        best: the policy of the best evaluation, as it is saved, with its `score` in each world of that evaluation; of
            independent policies each one's best.
        policy: the last policy, as it is saved.
    """

    actor: Actor
    critic: Critic
    rows: list[dict[str, Any]]
    final: Evaluation | None
    env_steps: int
    eval_steps: int
    seconds: float
    finished: bool
    best: dict[str, Any]
    policy: dict[str, Any]

    @property
    def best_score(self) -> float:
        """Largest score among all evaluations of the run, as the EvoGymCM paper's fitness."""
        return max(row["score"] for row in self.rows if "score" in row)


class _WorldCollector(Collector):
    """A collector whose state holds the live worlds too, so that a resumed run goes on within its episodes.

    The environment's own state must come with its `state_dict` (`get_extra_state`); without, resuming restarts the
    episodes.
    """

    _carrier: TensorDictBase

    def state_dict(self) -> dict[str, Any]:
        """Returns the environment's state and the policy's next input."""
        return {"env": dict(self.env.state_dict()), "carrier": self._carrier.to_dict()}

    def load_state_dict(self, state_dict: dict[str, Any], **kwargs: Any) -> None:
        """Restores what `state_dict` returned."""
        if not state_dict["env"]:
            return
        self.env.load_state_dict(state_dict["env"])
        self._carrier = TensorDict(state_dict["carrier"], batch_size=self._carrier.batch_size)


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Sets torch's number of threads for a while."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _copies(config: PPOConfig, env: EnvBase) -> int | None:
    """Returns the number of sets of weights, None for shared ones."""
    if config.sharing == "shared":
        return None
    for name in ("num_worlds", "eval_worlds"):
        value = getattr(config, name)
        if value is not None and value % env.num_designs:
            raise ValueError(f"{name}: got {value}, independent sharing needs a multiple of {env.num_designs} designs")
    return env.num_designs


class Trainer:
    """One training run, advanced update by update.

    Torch's global random state is left as it was: the run keeps its own.

    Args:
        make_env: makes the training environment and a fresh one for each evaluation.
        config: settings of the run.
    """

    def __init__(self, make_env: EnvFactory, config: PPOConfig) -> None:
        self.make_env, self.config = make_env, config
        self.env_steps, self.eval_steps, self.seconds = 0, 0, 0.0
        self._is_fresh = True
        self.best: dict[str, Any] | None = None
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            env = make_env(num_worlds=config.num_worlds, seed=config.seed)
            self.designs = env.num_designs
            copies = _copies(config, env)
            self.actor = make_actor(
                env,
                config.hidden,
                config.initial_std,
                network=config.network,
                context=config.context,
                copies=copies,
            )
            self.critic = make_critic(env, config.hidden, network=config.network, copies=copies)
            self.actor.noise_correlation = config.noise_correlation
            self.policy = self.actor if copies is None else PerDesign(self.actor, copies)
            self.learner = PPOLearner(self.actor, self.critic, config)
            self.collector = _WorldCollector(
                env,
                self.policy,
                frames_per_batch=config.frames_per_update,
                auto_register_policy_transforms=False,
                track_traj_ids=False,
            )
            self._rng_state = torch.get_rng_state()

    @contextmanager
    def _own_randomness(self) -> Iterator[None]:
        """Runs on the run's random state and keeps it."""
        with torch.random.fork_rng(devices=[]):
            torch.set_rng_state(self._rng_state)
            yield
            self._rng_state = torch.get_rng_state()

    @property
    def is_finished(self) -> bool:
        """Whether all env-steps are done."""
        return self.env_steps >= self.config.total_steps

    def update(self) -> dict[str, float]:
        """Collects one rollout, learns from it, and returns a row for the table."""
        start = time.perf_counter()
        with self._own_randomness(), limited_threads(self.config.torch_threads):
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
        """Plays an episode in each world of a fresh environment with the present policy."""
        start = time.perf_counter()
        env = self.make_env(num_worlds=self.config.eval_worlds or self.designs, seed=self.config.seed)
        with limited_threads(self.config.torch_threads):
            result = evaluate(self.policy, env)
        env.close(raise_if_closed=False)
        self.eval_steps += result.env_steps
        self.seconds += time.perf_counter() - start
        return result

    def policy_state(self) -> dict[str, Any]:
        """Returns the policy as it is saved: what makes the actor (`load_actor`), and what training goes on from."""
        return {"form": self.actor.form, **self.learner.state_dict()}

    def take_best(self, evaluation: Evaluation) -> bool:
        """Keeps the present policy in `best` where its score is the highest so far; returns whether it is.

        A shared policy is judged by its mean score over worlds. Independent ones are compared each with itself: `best`
        then holds policies of different moments.
        """
        score, state = torch.from_numpy(evaluation.score), self.policy_state()
        copies = self.actor.copies
        if copies is not None:
            score = score.reshape(-1, copies).mean(0)
        if self.best is None or (copies is None and score.mean() > self.best["score"].mean()):
            self.best = {name: copy.deepcopy(state[name]) for name in ("form", "actor", "critic")} | {"score": score}
            return True
        is_better = torch.zeros_like(score, dtype=torch.bool) if copies is None else score > self.best["score"]
        if not is_better.any():
            return False
        for name in ("actor", "critic"):
            for key, values in state[name].items():
                self.best[name][key][is_better] = values[is_better]
        self.best["score"] = torch.where(is_better, score, self.best["score"])
        return True

    def start_from(self, policy: Mapping[str, Any]) -> None:
        """Takes up a saved policy's weights (see `train`) instead of fresh ones."""
        copies, given = self.actor.copies, policy["form"]["copies"]
        for name, network in (("actor", self.actor), ("critic", self.critic)):
            weights = policy[name]
            if copies is not None and given is None:
                weights = stack_states([weights] * copies)
            network.load_state_dict(weights)
        if copies == given and "optimizer" in policy:
            self.learner.optimizer.load_state_dict(policy["optimizer"])
        self._is_fresh = False

    def state_dict(self) -> dict[str, Any]:
        """Returns all that is needed to go on: networks, optimiser, random state, live worlds, counters."""
        return {
            "learner": self.learner.state_dict(),
            "worlds": self.collector.state_dict(),
            "rng": self._rng_state,
            "noise": self.actor.noise,
            "env_steps": self.env_steps,
            "eval_steps": self.eval_steps,
            "seconds": self.seconds,
            "best": self.best,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what `state_dict` returned."""
        self.learner.load_state_dict(state["learner"])
        self.collector.load_state_dict(state["worlds"])
        self._rng_state, self.actor.noise = state["rng"], state["noise"]
        self.env_steps, self.eval_steps = state["env_steps"], state["eval_steps"]
        self.seconds, self.best = state["seconds"], state["best"]

    def close(self) -> None:
        """Releases the environment."""
        self.collector.shutdown()


def train(
    make_env: EnvFactory,
    config: PPOConfig,
    *,
    run: RunFolder | None = None,
    progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    start_from: Mapping[str, Any] | None = None,
    logger: Logger | None = None,
) -> TrainResult:
    """Trains a policy with PPO and returns it with its learning curve.

    The same settings and seed give the same policy, whether or not the run was stopped and resumed in between.

    Args:
        make_env: makes environments, e.g. `functools.partial(SoftRobotEnv, "Walker-v0", bodies=body)`.
        config: settings of the run.
        run: where to keep the table and checkpoints: `checkpoint` (to go on from), `best` and `final` (policies, the
            actor's weights with their row of the table). A folder opened to resume is gone on with. None keeps
            everything in memory.
        progress: called at the start (with the untrained policy's row, or the last one of a resumed run) and after
            every update.
        should_stop: asked after every update; the run then ends with a checkpoint. By default Ctrl-C stops it so.
        start_from: a saved policy (`RunFolder.load("best")`) to start from instead of fresh weights, for fine-tuning or
            for another body. Single weights start every one of independent policies.
        logger: any of TorchRL's loggers (CSV, TensorBoard, W&B); receives every number of every row.
    """
    trainer, rows = Trainer(make_env, config), []
    if start_from is not None:
        trainer.start_from(start_from)
    saved = run.load(CHECKPOINT) if run else None
    if run and saved:
        trainer.load_state_dict(saved["trainer"])
        run.keep_rows(saved["rows"])
        rows = run.rows()
        if progress:
            progress(Progress(trainer.env_steps, config.total_steps, trainer.seconds, rows[-1]))
    elif run:
        run.keep_rows(0)  # of a run that was killed before its first checkpoint
    with stop_on_interrupt() if should_stop is None else nullcontext(should_stop) as is_stopped:
        result = _loop(trainer, rows, run, progress, is_stopped, logger)
    trainer.close()
    return result


def _loop(
    trainer: Trainer,
    rows: list[dict[str, Any]],
    run: RunFolder | None,
    progress: Callable[[Progress], None] | None,
    is_stopped: Callable[[], bool],
    logger: Logger | None,
) -> TrainResult:
    """Updates until the end, with evaluations and checkpoints on the way."""
    config = trainer.config

    def record(row: dict[str, Any], evaluation: Evaluation | None) -> None:
        is_best = evaluation is not None and trainer.take_best(evaluation)
        if evaluation is not None:
            row |= {**evaluation.summary(), "seconds": trainer.seconds}
        rows.append(row)
        if run:
            run.append(row)
        if run and evaluation is not None:
            _save(trainer, is_best, row, len(rows), run)
        if logger:
            for name, value in row.items():
                logger.log_scalar(name, value, step=trainer.env_steps)
        if progress:
            progress(Progress(trainer.env_steps, config.total_steps, trainer.seconds, row))

    if not rows:
        record({"env_steps": 0}, trainer.evaluate())
    final = None
    while not (trainer.is_finished or is_stopped()):
        is_due = _is_due(trainer.env_steps, config)
        row = trainer.update()
        final = trainer.evaluate() if is_due or trainer.is_finished else None
        record(row, final)
    if not trainer.is_finished:
        final = None
        if run:
            run.save(CHECKPOINT, {"trainer": trainer.state_dict(), "rows": len(rows)})
    elif final is None:  # a run that had been finished before: the same evaluation again, which counts once
        counted = trainer.eval_steps
        final = trainer.evaluate()
        trainer.eval_steps = counted
    return TrainResult(
        trainer.actor,
        trainer.critic,
        rows,
        final,
        trainer.env_steps,
        trainer.eval_steps,
        trainer.seconds,
        trainer.is_finished,
        trainer.best or {},
        trainer.policy_state(),
    )


def _save(trainer: Trainer, is_best: bool, row: dict[str, Any], n_rows: int, run: RunFolder) -> None:
    """Keeps the policy where it is the best or the last one, and the state to go on from."""
    if is_best:
        run.save(BEST, {**(trainer.best or {}), "row": row})
    if trainer.is_finished:
        run.save(FINAL, trainer.policy_state() | {"row": row})
    run.save(CHECKPOINT, {"trainer": trainer.state_dict(), "rows": n_rows})


def _is_due(env_steps: int, config: PPOConfig) -> bool:
    """Whether the next update passes a multiple of the evaluation interval."""
    if not config.eval_interval:
        return False
    return (env_steps + config.frames_per_update) // config.eval_interval > env_steps // config.eval_interval
