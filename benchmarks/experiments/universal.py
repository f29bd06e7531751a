"""One policy for every body: what it is worth on bodies that it has not seen, and what further training adds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from statistics import mean
from typing import get_args

import numpy as np

from benchmarks.experiments import figures
from benchmarks.experiments.experiment import Comparison, Record
from benchmarks.experiments.tables import table, with_interval
from benchmarks.experiments.universal_job import (
    ALONE,
    BASELINE,
    FIVE,
    FRESH,
    GAITS,
    IDLE,
    LEARNT,
    OWN,
    SHAPE,
    SPECIALISTS,
    TUNED,
    UNSEEN,
    UniversalJob,
    five_bodies,
)
from evogymcm._settings import Material, check_choice
from evogymcm.algos.analysis import summarise
from evogymcm.algos.baselines import load_baseline
from evogymcm.algos.codesign import BodyPPOConfig
from evogymcm.algos.gaits import GaitConfig
from evogymcm.algos.gaits.search import trial_lengths
from evogymcm.algos.learning import PPOConfig, TrainConfig
from evogymcm.algos.learning.bodies import N_HELD_OUT

ARMS = (*LEARNT, FIVE, BASELINE, FRESH, GAITS, SPECIALISTS)


@dataclass(frozen=True)
class Universal(Comparison):
    """Policies for all bodies of 5x5 voxels, scored on random bodies that none of them has seen.

    "stream" trains one policy on a fresh random body in every episode; "pool-N" on N bodies only; "context-KIND" on the
    stream with another knowledge of the body; "baseline" is the one that comes with the package. Each is scored as it
    is ("zero-shot"), in the reactive setting also with its stiffness replaced by 1, and after fine-tuning on each of
    the first bodies by itself. "fresh" and "specialists" train a network for each of these bodies from fresh weights,
    for as long as fine-tuning lasts, and for long; "gaits" searches an open-loop gait for each, for as long as
    fine-tuning lasts. "five" trains one policy on five random bodies, and is scored on these too.

    Scores are robust ones, of the last policy. Intervals are bootstrap intervals (95 %) of the mean over bodies.

    Attributes:
        material: "reactive" (policies set stiffness) or "invariant".
        bodies: unseen bodies to score on, the first of those that all runs have.
        trained_on: how many of them are trained on, one by one, in fine-tuning and for specialists.
        finetune_steps: env-steps of that on each.
        finetune_rate: learning rate of fine-tuning at the start.
        finetune_std: exploration of fine-tuning at the start, in half ranges of the action.
        specialist_steps: env-steps of each specialist.
        ppo: settings of the training of one policy; its seed comes from `seeds`.
    """

    tasks: tuple[str, ...] = ("Walker-v0",)
    arms: tuple[str, ...] = ("stream", FRESH, SPECIALISTS)
    seeds: tuple[int, ...] = (0, 1, 2)
    material: Material = "invariant"
    bodies: int = N_HELD_OUT
    trained_on: int = 16
    finetune_steps: int = 50_000
    finetune_rate: float = 1e-3
    finetune_std: float = 0.5
    specialist_steps: int = 1_000_000
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(
            total_steps=10_000_000,
            num_worlds=512,
            minibatch=2048,
            learning_rate=2e-3,
            advantage_scale="world",
            hidden=64,
            eval_interval=500_000,
        )
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("material", self.material, get_args(Material))
        if self.ppo.seed:
            raise ValueError(f"ppo.seed: got {self.ppo.seed}, here it comes from seeds")
        if not 2 <= self.trained_on <= self.bodies <= N_HELD_OUT:  # 2: for the intervals
            raise ValueError(
                f"trained_on, bodies: got {self.trained_on} and {self.bodies}, expected 2 or more of up to {N_HELD_OUT}"
            )
        for name in ("finetune_steps", "specialist_steps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: got {getattr(self, name)}, must be at least 1")
        for name in ("finetune_rate", "finetune_std"):
            if not 0 < getattr(self, name) < inf:
                raise ValueError(f"{name}: got {getattr(self, name)}, must be above 0")
        if GAITS in self.arms:
            for task in self.tasks:
                trial_lengths(task, GaitConfig(env_steps=self.finetune_steps))  # are there env-steps enough?
        if BASELINE in self.arms:
            for task in self.tasks:
                load_baseline(task, self.material)  # is there one?

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return ARMS

    @property
    def steps_per_run(self) -> int:
        """The most env-steps of a run, but for whole rollouts."""
        tuned = self.trained_on * self.finetune_steps
        steps = {SPECIALISTS: self.trained_on * self.specialist_steps, FIVE: self.ppo.total_steps}
        steps |= dict.fromkeys((BASELINE, FRESH, GAITS), tuned)
        return max(steps.get(arm, self.ppo.total_steps + tuned) for arm in self.arms)

    def job(self, task: str, arm: str, seed: int) -> "UniversalJob":
        """Returns one run."""
        return UniversalJob(self, task, arm, seed)

    def training(self, task: str, arm: str, seed: int) -> TrainConfig:
        """Returns the settings of the training of one policy."""
        if arm == FIVE:
            texts = tuple(body.text for body in five_bodies())
            return TrainConfig(task, texts, self.material, ppo=replace(self.ppo, seed=seed), initial="fresh")
        changes = dict(LEARNT[arm])
        pool = changes.pop("pool", None)
        ppo = replace(self.ppo, seed=seed, eval_worlds=self.bodies, **changes)
        return TrainConfig(task, material=self.material, random_bodies=SHAPE, pool=pool, ppo=ppo, initial="fresh")

    def of_body(self, arm: str, seed: int) -> BodyPPOConfig:
        """Returns the settings of training on one body, with fresh networks or from a policy of many bodies."""
        steps = self.specialist_steps if arm == SPECIALISTS else self.finetune_steps
        config = BodyPPOConfig(total_steps=steps, eval_interval=0, seed=seed)
        if arm in (FRESH, SPECIALISTS):
            return config
        return replace(config, learning_rate=self.finetune_rate, initial_std=self.finetune_std)

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm over its finished runs, with the means over seeds of each body's scores."""
        rows = []
        for task, arm, group in self.groups([run for run in runs if run["finished"]]):
            kinds = [kind for kind in (UNSEEN, IDLE, TUNED, ALONE, OWN) if kind in group[0]["scores"]]
            of_bodies = {kind: np.mean([run["scores"][kind] for run in group], 0).tolist() for kind in kinds}
            row: Record = {"task": task, "arm": arm, "seeds": len(group), "scores": of_bodies}
            row["env_steps"] = mean(run["env_steps"] for run in group)
            row["of_seeds"] = {kind: [mean(run["scores"][kind]) for run in group] for kind in kinds}
            rows.append(row | {"seconds": mean(run["seconds"] for run in group)})
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns what policies are worth on unseen bodies, beside specialists, and what stiffness control adds."""
        parts = [table(_lines(rows, self.trained_on))]
        if own := [row for row in rows if OWN in row["scores"]]:
            parts.append(table([("of the five bodies it was trained on", "arm", "score", "each"), *map(_own, own)]))
        gains = [_gain(row) for row in rows if IDLE in row["scores"]]
        if gains:
            head = ("stiffness control on unseen bodies", "arm", "score", "with stiffness 1", "difference", "better on")
            parts.append(table([head, *gains]))
        return "\n\n".join(parts) if rows else ""

    def plot(self, runs: Sequence[Record], path: Path) -> None:
        """Draws the scores of unseen bodies in training, one panel a task; nothing where no arm trains on others."""
        learnt = [run for run in runs if run["label"] in LEARNT]
        figures.unseen_curves(learnt, self.tasks, [arm for arm in self.arms if arm in LEARNT], path)


def _lines(rows: Sequence[Record], n: int) -> list[Sequence[str]]:
    head = ["task", "arm", "seeds", "env-steps", "zero-shot", "of each seed", f"zero-shot, first {n}"]
    lines: list[Sequence[str]] = [[*head, f"trained on these {n}", "of specialists", "seconds"]]
    for row in rows:
        scores, known = row["scores"], [other for other in rows if other["arm"] == SPECIALISTS]
        best = [mean(other["scores"][ALONE]) for other in known if other["task"] == row["task"]]
        first = scores.get(UNSEEN, [])[:n]
        tuned = scores.get(TUNED, scores.get(ALONE, []))
        cells = [row["task"], row["arm"], str(row["seeds"]), f"{row['env_steps']:,.0f}"]
        cells += [_mean(scores.get(UNSEEN)), " ".join(f"{value:.2f}" for value in row["of_seeds"].get(UNSEEN, []))]
        shares = [f"{mean(values) / best[0]:.0%}" for values in (first, tuned) if values and best]
        lines.append([*cells, _mean(first), _mean(tuned), ", ".join(shares), f"{row['seconds']:,.0f}"])
    return lines


def _own(row: Record) -> Sequence[str]:
    """What a policy is worth on the bodies that it was trained on."""
    scores = row["scores"][OWN]
    return (row["task"], row["arm"], f"{mean(scores):.2f}", " ".join(f"{score:.2f}" for score in scores))


def _mean(values: Sequence[float] | None) -> str:
    if not values:
        return ""
    found = summarise(values)
    return with_interval(found.mean, (found.low, found.high), ".2f")


def _gain(row: Record) -> Sequence[str]:
    """What a policy loses where its stiffness is replaced by 1, body by body."""
    own, idle = (np.array(row["scores"][kind]) for kind in (UNSEEN, IDLE))
    found, better = summarise((own - idle).tolist()), int((own > idle).sum())
    difference = with_interval(found.mean, (found.low, found.high), "+.2f")
    return (row["task"], row["arm"], f"{own.mean():.2f}", f"{idle.mean():.2f}", difference, f"{better} of {len(own)}")


_SHORT = replace(Universal().ppo, total_steps=3_000_000, eval_interval=250_000)
SIZES: Mapping[str, Universal] = {
    "quick": Universal(
        seeds=(0,), arms=("stream", FRESH), bodies=16, trained_on=4, ppo=replace(_SHORT, total_steps=500_000)
    ),
    "small": Universal(seeds=(0,), ppo=_SHORT),
    "paper": Universal(),
}
