"""One run of the experiment on one policy for every body: training, scores, and training on single bodies."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.experiments.experiment import Record, Tell
from evogymcm._settings import Material
from evogymcm.algos.baselines import load_baseline
from evogymcm.algos.codesign import Design, score_alone, train_designs
from evogymcm.algos.codesign.inner_loop import Policy
from evogymcm.algos.codesign.scoring import score_gaits, score_together
from evogymcm.algos.gaits import GaitConfig, search_gaits
from evogymcm.algos.learning import Progress, train
from evogymcm.algos.learning.bodies import held_out_bodies
from evogymcm.algos.learning.initial import exploring, following
from evogymcm.algos.learning.transfer import carried_over
from evogymcm.algos.runs import RunFolder, RunRecord, load_policy
from evogymcm.algos.runs.policies import SavedPolicy
from evogymcm.body import Body, sample_body
from evogymcm.envs import SoftRobotEnv, TaskEngine

if TYPE_CHECKING:
    from benchmarks.experiments.universal import Universal

SHAPE = (5, 5)
FIVE, BASELINE, FRESH, GAITS, SPECIALISTS = "five", "baseline", "fresh", "gaits", "specialists"
LEARNT: Mapping[str, Mapping[str, Any]] = {  # arms that train one policy for all bodies -> settings that differ
    "stream": {},
    **{f"pool-{count}": {"pool": count} for count in (32, 64, 256)},
    **{f"context-{kind}": {"context": kind} for kind in ("none", "message", "attention")},
}
UNSEEN, IDLE, TUNED, ALONE, OWN = "zero-shot", "stiffness 1", "fine-tuned", "alone", "own"  # kinds of scores
_STARTS = 8  # of a robust score


def five_bodies() -> list[Body]:
    """Returns random bodies that policies in the literature are compared on: of the seeds 0 to 4."""
    return [sample_body(SHAPE, seed) for seed in range(5)]


def _networks(saved: SavedPolicy) -> Policy:
    return {name: saved.state[name] for name in ("form", "actor", "critic")}


@dataclass(frozen=True)
class UniversalJob:
    """One arm on one task with one seed."""

    experiment: "Universal"
    task: str
    arm: str
    seed: int

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return f"{self.task}-{self.arm}-seed{self.seed}"

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Trains and scores in `folder / name` and returns all numbers of the run."""
        run = RunFolder(folder / self.name, asdict(self), resume=resume)
        if known := run.read_json("result.json"):  # which is written at the end only
            return dict(known)
        record: Record = {"task": self.task, "label": self.arm, "seed": self.seed, "finished": False, "curve": []}
        record |= {"env_steps": 0, "seconds": 0.0, "scores": {}}
        scores: dict[str, list[float]] = record["scores"]
        if self.arm == GAITS:
            return self._search(run, record, tell, should_stop)
        policy: Policy | None = None
        if self.arm in LEARNT or self.arm == FIVE:
            record |= self._learn(run.path / "policy", resume, tell, should_stop)
            if not record.pop("is_learnt"):
                return record
            policy = _networks(load_policy(run.path / "policy" / "final.pt"))
        elif self.arm == BASELINE:
            policy = _networks(load_baseline(self.task, self.experiment.material))
        if policy is not None:
            unseen = self._designs(self.experiment.bodies)
            scores[UNSEEN] = self._score_one(policy, unseen)
            if self.experiment.material == "reactive":
                scores[IDLE] = self._score_one(self._without_stiffness(policy), unseen, "invariant")
            if self.arm == FIVE:
                scores[OWN] = self._score_one(policy, [Design(body) for body in five_bodies()])
                record["finished"] = True
                run.write_json("result.json", record)
                return record
        before, ppo = record["env_steps"], self.experiment.of_body(self.arm, self.seed)
        place = RunFolder(run.path / "bodies", {"policies": self.arm}, resume=resume)
        trained = train_designs(
            self._make_env(self.experiment.material),
            self._designs(self.experiment.trained_on),
            ppo if policy is None else following(ppo, policy),
            run=place,
            initial=None if policy is None else [exploring(policy, ppo.initial_std)] * self.experiment.trained_on,
            progress=lambda state: tell(before + state.env_steps, state.row.get("score")),
            should_stop=should_stop,
        )
        if trained.finished:
            found = score_alone(
                self._make_env(self.experiment.material), self._designs(len(trained.last)), trained.last, starts=_STARTS
            )
            scores[ALONE if policy is None else TUNED] = found.robust.tolist()
            last = place.rows()[-1]
            record |= {name: record[name] + last[name] for name in ("env_steps", "seconds")}
            record["finished"] = True
            run.write_json("result.json", record)
        return record

    def _learn(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Trains one policy for all bodies, and returns what is to be told of that."""
        settings = self.experiment.training(self.task, self.arm, self.seed)
        run = RunFolder(folder, asdict(settings), resume=resume)

        def progress(state: Progress) -> None:
            tell(state.env_steps, state.row.get("score"))

        result = train(settings, run=run, progress=progress, should_stop=should_stop, num_threads=1)
        told = RunRecord.read(folder).as_dict()
        kept = {name: told[name] for name in ("curve", "env_steps", "seconds")}
        return kept | {"is_learnt": result.finished}

    def _make_env(self, material: Material) -> partial[SoftRobotEnv]:
        return partial(SoftRobotEnv, self.task, material=material, num_threads=1, grid_shape=SHAPE)

    def _without_stiffness(self, policy: Policy) -> Policy:
        """Returns the policy of the invariant setting that has the actuation of one that sets stiffness too."""
        env = self._make_env("invariant")(bodies=held_out_bodies(SHAPE, 1), num_worlds=1)
        try:
            return carried_over(policy, env)
        finally:
            env.close(raise_if_closed=False)

    def _designs(self, count: int) -> list[Design]:
        return [Design(body) for body in held_out_bodies(SHAPE, count)]

    def _score_one(self, policy: Policy, designs: Sequence[Design], material: Material | None = None) -> list[float]:
        """Returns the robust scores of designs that one policy drives."""
        make_env = self._make_env(material or self.experiment.material)
        robust: list[float] = score_together(make_env, [designs], [policy], starts=_STARTS).robust[0].tolist()
        return robust

    def _search(self, run: RunFolder, record: Record, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Searches a gait for each of the first bodies, anew if it is stopped: that takes seconds."""
        bodies, start = held_out_bodies(SHAPE, self.experiment.trained_on), time.perf_counter()
        found = search_gaits(
            self.task,
            bodies,
            GaitConfig(env_steps=self.experiment.finetune_steps, seed=self.seed),
            progress=lambda steps, best: tell(steps * len(bodies), float(best.mean())),
            should_stop=should_stop,
            material=self.experiment.material,
            num_threads=1,
        )
        if not found.finished:
            return record
        designs = [Design(body) for body in bodies]
        make_engine = partial(
            TaskEngine, self.task, material=self.experiment.material, with_voxels=False, num_threads=1
        )
        record["scores"][ALONE] = score_gaits(make_engine, designs, found.waves, starts=_STARTS).robust.tolist()
        steps = int(found.env_steps.sum())
        record |= {"env_steps": steps, "seconds": time.perf_counter() - start, "finished": True}
        run.write_json("result.json", record)
        return record
