"""Evolution of bodies with gaits, and then a policy of its own for each of the best bodies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean

from benchmarks.experiments.evolved_gaits import ARMS, CONTROL, EvolvedGaits, EvolveJob
from benchmarks.experiments.experiment import Comparison, Record, Tell
from benchmarks.experiments.paper import PAPER, PUBLISHED
from benchmarks.experiments.tables import table, with_interval
from evogymcm.algos.analysis import difference, summarise
from evogymcm.algos.codesign import EvolveConfig, SpecialistConfig, specialise


@dataclass(frozen=True)
class SpecialistJob:
    """One evolution, and the training of its best designs."""

    evolution: EvolveJob
    specialists: SpecialistConfig

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return self.evolution.name

    def run(self, folder: Path, resume: bool, tell: Tell, should_stop: Callable[[], bool]) -> Record:
        """Evolves in `folder / name`, trains in its folder `specialists`, and returns all numbers of both."""
        record = self.evolution.run(folder, resume, tell, should_stop)
        if not record["finished"]:
            return record
        before = record["env_steps"]
        found = specialise(
            folder / self.name,
            replace(self.specialists, ppo=replace(self.specialists.ppo, seed=record["seed"])),
            progress=lambda state: tell(before + state.env_steps, state.row.get("score")),
            should_stop=should_stop,
            num_threads=1,
        )
        told = {"env_steps": found.env_steps, "designs": found.table()}
        return record | {"finished": found.finished, "specialists": told}


@dataclass(frozen=True)
class SpecialistsOfEvolution(Comparison):
    """What policies of their own are worth to bodies that have evolved with gaits.

    Each run of `evolve` ends with some of its survivors, of different bodies; a policy is trained for each, from fresh
    weights, and compared with the gait that the body has evolved with, both by their robust scores.

    Attributes:
        evolve: settings of each evolution; task, seed and material come from the fields above.
        specialists: settings of the training; its seed comes from `seeds`.
    """

    tasks: tuple[str, ...] = tuple(PAPER)
    arms: tuple[str, ...] = (CONTROL,)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    evolve: EvolveConfig = field(default_factory=lambda: EvolveConfig(max_env_steps=2_000_000, num_threads=1))
    specialists: SpecialistConfig = field(default_factory=lambda: SpecialistConfig(count=2, initial="fresh"))

    def __post_init__(self) -> None:
        super().__post_init__()
        self._evolution()  # are its settings right?
        if self.specialists.ppo.seed:
            raise ValueError(f"specialists.ppo.seed: got {self.specialists.ppo.seed}, here it comes from seeds")

    @property
    def allowed_arms(self) -> tuple[str, ...]:
        """All arms that there are."""
        return tuple(ARMS)

    @property
    def steps_per_run(self) -> int:
        """Env-steps of a run, but for whole generations and rollouts, and evaluations."""
        return self.evolve.max_env_steps + self.specialists.count * self.specialists.ppo.total_steps

    def _evolution(self) -> EvolvedGaits:
        return EvolvedGaits(self.tasks, self.arms, self.seeds, self.evolve)

    def job(self, task: str, arm: str, seed: int) -> SpecialistJob:
        """Returns one run."""
        return SpecialistJob(self._evolution().job(task, arm, seed), self.specialists)

    def summarise(self, runs: Sequence[Record]) -> list[Record]:
        """Returns one row a task and arm over its finished runs: of each run the best design, before and after."""
        rows = []
        for task, arm, group in self.groups([run for run in runs if run["finished"]]):
            row: Record = {"task": task, "arm": arm, "env_steps": mean(run["env_steps"] for run in group)}
            row["added"] = mean(run["specialists"]["env_steps"] for run in group)
            tables = [run["specialists"]["designs"] for run in group]
            for when in ("before", "now"):
                best = [max((design[when] for design in designs), key=_worth) for designs in tables]
                row[when] = {name: [one[name] for one in best] for name in ("score", "return")}
            row["either"] = [max((d[when] for d in ds for when in ("before", "now")), key=_worth) for ds in tables]
            row["better"] = sum(_worth(d["now"]) > _worth(d["before"]) for ds in tables for d in ds)
            rows.append(row | {"designs": sum(map(len, tables))})
        return rows

    def table(self, rows: Sequence[Record]) -> str:
        """Returns gaits and policies beside each other."""
        head = ["task", "arm", "seeds", "env-steps", "robust score", "return", "env-steps of policies"]
        head += ["robust score", "return", "difference", "better policies", "return of the better", "published"]
        lines: list[Sequence[str]] = [head]
        for row in rows:
            before, now = row["before"], row["now"]
            cells = [row["task"], row["arm"], str(len(before["score"])), f"{row['env_steps']:,.0f}"]
            cells += [str(summarise(before["score"])), str(summarise(before["return"])), f"{row['added']:,.0f}"]
            cells += [str(summarise(now["score"])), str(summarise(now["return"]))]
            if len(before["score"]) > 1:
                cells.append(with_interval(*difference(before["score"], now["score"], is_paired=True), "+.2f"))
            else:
                cells.append(f"{now['score'][0] - before['score'][0]:+.2f}")
            cells += [f"{row['better']} of {row['designs']}", str(summarise([one["return"] for one in row["either"]]))]
            lines.append([*cells, f"{PUBLISHED[row['task']]:.2f}"])
        return f"{table(lines)}\n\n{_NOTE}" if rows else ""


def _worth(told: Record) -> float:
    """What a design is worth: its robust score, and its return where that is less for a penalty at the end."""
    return float(min(told["score"], told["return"]))


_NOTE = (
    "First with the gaits that the bodies have evolved with, then with policies that were trained for them alone: of"
    " each run the best design, by its robust score, or its return where that is lower (it ends with a penalty)."
    " Difference: of robust scores, of pairs of equal seeds. Better policies: how many designs move better with theirs"
    " than with their gait, by the same rule."
)

SIZES = {
    "quick": SpecialistsOfEvolution(
        ("AreaMinimizer-v0",), seeds=(0,), evolve=EvolveConfig(max_env_steps=100_000, num_threads=1)
    ),
    "small": SpecialistsOfEvolution(),
    "paper": SpecialistsOfEvolution(specialists=replace(SpecialistConfig(), count=8, initial="fresh")),
}
