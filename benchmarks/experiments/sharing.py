"""What it costs, and what it gives, to share one policy among many bodies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Experiment, Record, Tell
from benchmarks.experiments.tables import table
from evogymcm import Body, sample_body
from evogymcm.algos.analysis import difference, summarise
from evogymcm.algos.codesign import BodyPPOConfig, Design, score_alone, train_designs
from evogymcm.algos.codesign.inner_loop import MakeEnv, Policy, Trained, holding
from evogymcm.algos.learning import Trainer
from evogymcm.algos.runs import RunFolder
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
COMPARED = (  # on the same bodies
    ("seen", "shared", "independent"),
    ("unseen", "zero-shot", "untrained"),
    ("unseen", "fine-tuned", "zero-shot"),
    ("unseen", "fine-tuned", "scratch"),
)
_MINIBATCH = 512  # env-steps per gradient step of the shared policy, as for a single robot
_EVALUATIONS = {"seen": 20, "unseen": 5}  # on the way

Scores = dict[str, dict[str, list[float]]]  # bodies ("seen", "unseen") -> policy -> score of each body


@dataclass(frozen=True)
class Sharing(Experiment):
    """Two arms of equal env-steps, on random 5x5 bodies.

    "shared" trains one policy on bodies at once, scores it on bodies that it has not seen ("zero-shot"), and fine-tunes
    it there, each body for itself. "independent" trains a network for each of the same bodies, and then, for as long as
    fine-tuning lasts, one from scratch for each unseen body.

    Scores are those of the last policy, deterministic, in fresh worlds, each body by itself. Intervals are bootstrap
    intervals (95 %) of the mean over bodies, and differences on the same bodies are paired: they tell how much the draw
    of bodies matters. How much the training seed matters, only runs with other seeds can tell.

    Attributes:
        task: id of the task.
        material: "reactive" (policies set stiffness) or "invariant".
        bodies: to train on.
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

    def jobs(self) -> list["ArmJob"]:
        """Returns both arms."""
        return [ArmJob(self, arm) for arm in ARMS]

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns rows of scores, and of differences: on the same bodies, and between seen and unseen ones."""
        scores = _merged(runs)
        training = {policy: record for arm in runs for policy, record in arm["training"].items() if record["finished"]}
        rows: list[Record] = []
        for bodies, of_bodies in scores.items():
            for policy, values in of_bodies.items():
                known = training.get(policy)
                rows.append(
                    {
                        "bodies": bodies,
                        "policy": policy,
                        "count": len(values),
                        "env_steps": known["env_steps"] if known else None,
                        **_mean(values),
                        "median": float(np.median(values)),
                        "best_in_training": float(np.mean(known["best_scores"])) if known else None,
                    }
                )
        for bodies, one, other in COMPARED:
            if one in scores[bodies] and other in scores[bodies]:
                gain = np.subtract(scores[bodies][one], scores[bodies][other]).tolist()
                better = f"{sum(value > 0 for value in gain)} of {len(gain)}"
                rows.append({"difference": f"{one} - {other}, {bodies}", **_mean(gain), "better_on": better})
        if "zero-shot" in scores["unseen"]:
            gain, interval = difference(scores["seen"]["shared"], scores["unseen"]["zero-shot"])
            row = {"difference": "zero-shot, unseen - shared, seen", "mean": gain, "interval": interval}
            rows.append(row | {"better_on": ""})
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns the scores, and the differences."""

        def span(row: Mapping[str, Any]) -> str:
            return "{:.2f} to {:.2f}".format(*row["interval"])

        lines: list[Sequence[str]] = [
            ("bodies", "policy", "env-steps", "mean score", "95 % interval", "median", "best in training")
        ]
        gains: list[Sequence[str]] = [("difference of means", "", "95 % interval", "better on")]
        for row in rows:
            if "difference" in row:
                gains.append((row["difference"], f"{row['mean']:+.2f}", span(row), row["better_on"]))
                continue
            steps = "" if row["env_steps"] is None else f"{row['env_steps']:,}"
            best = "" if row["best_in_training"] is None else f"{row['best_in_training']:.2f}"
            head = (f"{row['count']} {row['bodies']}", row["policy"], steps, f"{row['mean']:.2f}")
            lines.append((*head, span(row), f"{row['median']:.2f}", best))
        return "\n\n".join(table(part) for part in (lines, gains) if len(part) > 1)

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws each body's scores, sorted, and how training on the unseen bodies went."""
        training = {policy: record["curve"] for arm in runs for policy, record in arm["training"].items()}
        unseen = {policy: training[policy] for policy in ORDER["unseen"] if policy in training}
        figures.sharing(_merged(runs), unseen, path)


def _merged(runs: Sequence[Record]) -> Scores:
    """Returns the scores of all arms together."""
    found: Scores = {bodies: {} for bodies in ORDER}
    for arm in runs:
        for bodies, scores in arm["scores"].items():
            found[bodies] |= scores
    return {bodies: {p: found[bodies][p] for p in policies if p in found[bodies]} for bodies, policies in ORDER.items()}


def _mean(values: Sequence[float]) -> Record:
    """Returns the mean over bodies and its interval."""
    found = summarise(values)
    return {"mean": found.mean, "interval": (found.low, found.high)}


@dataclass(frozen=True)
class ArmJob:
    """One arm."""

    experiment: Sharing
    arm: str

    @property
    def name(self) -> str:
        """Name of the arm's folder."""
        return self.arm

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Trains and scores in `folder / name` and returns all numbers of the arm."""
        run = RunFolder(folder / self.name, asdict(self), resume=resume)
        make_env = partial(SoftRobotEnv, self.experiment.task, material=self.experiment.material, num_threads=1)
        designs = self.experiment.designs()
        scores: Scores = {"seen": {}, "unseen": {}}
        training: Record = {}

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
            training[policy] = _training_record(place.rows(), trained, len(designs[bodies]))
            if trained.finished:
                score(bodies, policy, trained.last)
            return trained

        if self.arm == "shared":
            fresh = _untrained_policy(make_env, designs["seen"], self.experiment.ppo("shared"))
            for bodies, group in designs.items():
                score(bodies, "untrained", [fresh] * len(group))
        first, second = ARMS[self.arm]
        start, trained = None, train("seen", first, None, 0)
        if trained.finished:
            if self.arm == "shared":
                start = [trained.last[0]] * len(designs["unseen"])
                score("unseen", "zero-shot", start)
            trained = train("unseen", second, start, training[first]["env_steps"])
        record: Record = {"task": self.experiment.task, "label": self.arm, "seed": self.experiment.seed}
        record |= {"finished": trained.finished and second in training, "scores": scores, "training": training}
        run.write_json("result.json", record)
        return record


def _untrained_policy(make_env: MakeEnv, designs: Sequence[Design], ppo: BodyPPOConfig) -> Policy:
    """Returns the policy that shared training starts from."""
    with Trainer(holding(make_env, designs), ppo.of_bodies(len(designs))) as trainer:
        return trainer.policy_state()


def _training_record(rows: Sequence[Mapping[str, Any]], trained: Trained, count: int) -> Record:
    """Returns what is to be told of a training of `count` bodies; its seconds are those of all sittings."""
    return {
        "finished": trained.finished,
        "env_steps": rows[-1]["env_steps"],
        "seconds": rows[-1]["seconds"],
        "best_scores": trained.scores.tolist(),
        "curve": [[row["env_steps"] / count, row["score"]] for row in rows if "score" in row],
    }


SIZES: Mapping[str, Sharing] = {
    "quick": Sharing(bodies=8, unseen=4, total_steps=100_000, finetune_steps=10_000),
    "small": Sharing(total_steps=1_000_000),
    "paper": Sharing(),
}
