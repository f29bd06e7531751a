"""Sharing one policy among many bodies: the experiment, and one job = one arm."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from evogymcm import Body, sample_body
from evogymcm.algos import BodyPPOConfig, PPOConfig, RunFolder, make_actor
from evogymcm.algos.codesign import Design, score_alone, train_designs
from evogymcm.algos.codesign.inner_loop import MakeEnv, Policy, Trained, holding
from evogymcm.algos.learning.threads import limited_threads
from evogymcm.envs import SoftRobotEnv, as_task

SHAPE = (5, 5)
ARMS: Mapping[str, tuple[str, str]] = {  # -> policies trained on the seen bodies, and then on the unseen ones
    "shared": ("shared", "fine-tuned"),
    "independent": ("independent", "scratch"),
}
ORDER: Mapping[str, tuple[str, ...]] = {  # bodies -> policies scored on them
    "seen": ("untrained", "shared", "independent"),
    "unseen": ("untrained", "zero-shot", "fine-tuned", "scratch"),
}
_MINIBATCH = 512  # env-steps per gradient step of the shared policy, as for a single robot
_EVALUATIONS = {"seen": 20, "unseen": 5}  # on the way

Scores = dict[str, dict[str, list[float]]]  # bodies ("seen", "unseen") -> policy -> score of each body


@dataclass(frozen=True)
class Experiment:
    """What to measure.

    Attributes:
        task: id of the task.
        material: "reactive" (policies set stiffness) or "invariant".
        bodies: random 5x5 bodies to train on.
        unseen: other ones to transfer to.
        total_steps: env-steps of training on all seen bodies together, the same in both arms.
        finetune_steps: env-steps of training on each unseen body.
        worlds: worlds of each body.
        context: what a voxel knows of the rest of its body, see `PPOConfig`.
        hidden: width of the networks; None for the default.
        seed: of bodies, weights and exploration.
    """

    task: str = "Walker-v0"
    material: Literal["reactive", "invariant"] = "reactive"
    bodies: int = 32
    unseen: int = 16
    total_steps: int = 2_000_000
    finetune_steps: int = 50_000
    worlds: int = 8
    context: Literal["none", "body", "message", "attention"] = "body"
    hidden: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        as_task(self.task)
        if self.material not in ("reactive", "invariant"):
            raise ValueError(f"material: got {self.material!r}, allowed are 'reactive' and 'invariant'")
        least = {"bodies": 2, "unseen": 2, "total_steps": 1, "finetune_steps": 1, "worlds": 1}  # 2: for the intervals
        for name, low in least.items():
            if getattr(self, name) < low:
                raise ValueError(f"{name}: got {getattr(self, name)}, must be at least {low}")
        self.ppo("shared")

    def designs(self) -> dict[str, list[Design]]:
        """Returns the seen and the unseen bodies, all of them different."""
        drawn: dict[Body, None] = {}
        for stream, count in enumerate((self.bodies, self.unseen)):
            rng, goal = np.random.default_rng((self.seed, stream)), len(drawn) + count
            while len(drawn) < goal:
                drawn.setdefault(sample_body(SHAPE, rng))
        designs = [Design(body) for body in drawn]
        return {"seen": designs[: self.bodies], "unseen": designs[self.bodies :]}

    def ppo(self, policy: str) -> BodyPPOConfig:
        """Returns how a policy of `ARMS` is trained: the settings of one body, as `train_designs` takes them.

        Fine-tuning goes on from where the schedules ended, as in co-design: less exploration, a lower learning rate.
        """
        is_first = policy in ORDER["seen"]
        steps = -(-self.total_steps // self.bodies) if is_first else self.finetune_steps
        config = BodyPPOConfig(
            total_steps=steps,
            num_worlds=self.worlds,
            eval_interval=max(1, steps // _EVALUATIONS["seen" if is_first else "unseen"]),
            context=self.context,
            hidden=self.hidden,
            seed=self.seed,
        )
        if policy == "shared":
            return replace(config, sharing="shared", minibatch=max(1, _MINIBATCH // self.bodies))
        config = replace(config, minibatch=max(1, config.frames_per_update // 4))
        if policy == "fine-tuned":
            return replace(config.finetuning(steps), eval_interval=config.eval_interval)
        return config

    @property
    def steps_per_run(self) -> int:
        """Env-steps of an arm, in whole rollouts."""
        steps = 0
        for policy, count in zip(ARMS["shared"], (self.bodies, self.unseen), strict=True):
            ppo = self.ppo(policy)
            steps += -(-ppo.total_steps // ppo.frames_per_update) * ppo.frames_per_update * count
        return steps

    def jobs(self) -> list["Job"]:
        """Returns both arms."""
        return [Job(self, arm) for arm in ARMS]


@dataclass(frozen=True)
class Job:
    """One arm."""

    experiment: Experiment
    arm: str

    @property
    def name(self) -> str:
        """Name of the arm's folder."""
        return self.arm

    def run(
        self, folder: Path, resume: bool, tell: Callable[[int, float | None], None], should_stop: Callable[[], bool]
    ) -> dict[str, Any]:
        """Trains and scores in `folder / name` and returns all numbers of the arm, those so far if it is stopped.

        Args:
            folder: of the experiment.
            resume: go on with what is there.
            tell: called with the env-steps done and the latest mean score, None where there is no new one.
            should_stop: asked after every update.
        """
        run = RunFolder(folder / self.name, asdict(self), resume=resume)
        make_env = partial(SoftRobotEnv, self.experiment.task, material=self.experiment.material, num_threads=1)
        designs = self.experiment.designs()
        scores: Scores = {"seen": {}, "unseen": {}}
        training: dict[str, Any] = {}

        def score(bodies: str, policy: str, weights: Sequence[Policy]) -> None:
            scores[bodies][policy] = score_alone(make_env, designs[bodies], weights).score.tolist()

        def train(bodies: str, policy: str, start: list[Policy] | None, before: int) -> Trained:
            ppo, place = self.experiment.ppo(policy), RunFolder(run.path / policy, {"policy": policy}, resume=resume)
            trained = train_designs(
                make_env,
                designs[bodies],
                ppo,
                run=place,
                initial=start,
                progress=lambda state: tell(before + state.env_steps, state.row.get("score")),
                should_stop=should_stop,
            )
            training[policy] = _training_record(place.rows(), trained, ppo, len(designs[bodies]))
            if trained.finished:
                score(bodies, policy, trained.last)
            return trained

        if self.arm == "shared":
            fresh = untrained_policy(make_env, designs["seen"], self.experiment.ppo("shared"))
            for bodies, group in designs.items():
                score(bodies, "untrained", [fresh] * len(group))
        first, second = ARMS[self.arm]
        start, trained = None, train("seen", first, None, 0)
        if trained.finished:
            if self.arm == "shared":
                start = [trained.last[0]] * len(designs["unseen"])
                score("unseen", "zero-shot", start)
            trained = train("unseen", second, start, training[first]["env_steps"])
        record = {"arm": self.arm, "finished": trained.finished and second in training}
        record |= {"scores": scores, "training": training}
        run.write_json("result.json", record)
        return record


def untrained_policy(make_env: MakeEnv, designs: Sequence[Design], ppo: PPOConfig) -> Policy:
    """Returns the policy that shared training starts from."""
    env = holding(make_env, designs)(num_worlds=len(designs), seed=ppo.seed)
    generator = torch.Generator().manual_seed(ppo.seed)
    with limited_threads(ppo.torch_threads):
        actor = make_actor(env, ppo.hidden, ppo.initial_std, context=ppo.context, generator=generator)
    return {"form": actor.form, "actor": actor.state_dict()}


def _training_record(rows: Sequence[Mapping[str, Any]], trained: Trained, ppo: PPOConfig, count: int) -> dict[str, Any]:
    """Returns what is to be told of a training of `count` bodies; its times are those of all sittings."""
    steps, seconds = rows[-1]["env_steps"], rows[-1]["seconds"]
    return {
        "ppo_of_a_body": asdict(ppo),
        "bodies": count,
        "finished": trained.finished,
        "env_steps": steps,
        "evaluation_steps": trained.env_steps - steps,
        "seconds": seconds,
        "env_steps_per_s": steps / max(seconds, 1e-9),
        "best_scores": trained.scores.tolist(),
        "curve": [[row["env_steps"] / count, row["score"]] for row in rows if "score" in row],
    }
