"""Specialists: the best designs that a search leaves behind, each with a policy that is trained for it alone."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from evogymcm.algos.codesign.design import Design
from evogymcm.algos.codesign.evolution import worth
from evogymcm.algos.codesign.inner_loop import Policy, apart
from evogymcm.algos.codesign.scoring import Scores, score_alone
from evogymcm.algos.codesign.specialist_config import SpecialistConfig
from evogymcm.algos.learning.bodies import as_texts
from evogymcm.algos.learning.config import TrainConfig
from evogymcm.algos.learning.loop import Progress
from evogymcm.algos.learning.training import train
from evogymcm.algos.runs.folder import RunFolder
from evogymcm.algos.runs.record import RunRecord
from evogymcm.envs import SoftRobotEnv

FOLDER = "specialists"
_TABLE = "specialists.json"
_STARTS = 8  # of robust scores


@dataclass(frozen=True, eq=False)
class Specialists:
    """Designs of a search with policies of their own.

    Attributes:
        rows: of the search's table, one for each of D designs, the best first.
        designs: the designs.
        policies: each one's best policy, see `PPOConfig.selection`.
        scores: of these policies, each played by itself, from eight starts; None if the training was stopped.
        env_steps: env-steps simulated, including evaluations.
    """

    rows: Sequence[Mapping[str, Any]]
    designs: Sequence[Design]
    policies: Sequence[Policy]
    scores: Scores | None
    env_steps: int

    @property
    def finished(self) -> bool:
        """Whether the training has ended."""
        return self.scores is not None

    def table(self) -> list[dict[str, Any]]:
        """Returns one row a design: its number and body, and what it was worth in the search ("before") and is now.

        That is its robust score (its fitness, where the search has played it from one start only) and its return.
        """
        if self.scores is None:
            return []
        out = []
        for i, row in enumerate(self.rows):
            before = {"score": row.get("robust_score", row["fitness"]), "return": row["return"]}
            values = self.scores.robust[i], self.scores.returns[i], self.scores.spread[i]
            now = dict(zip(("score", "return", "spread"), map(float, values), strict=True))
            out.append({"index": row["index"], "body": row["body"], "before": before, "now": now})
        return out


def specialise(
    search: str | os.PathLike[str],
    config: SpecialistConfig | None = None,
    *,
    run: RunFolder | str | os.PathLike[str] | None = None,
    progress: Callable[[Progress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    num_threads: int | None = None,
) -> Specialists:
    """Trains a policy for each of the best designs of a search, for that design alone.

    A search can afford little of each design: a short training, or a gait that senses nothing. What it leaves behind is
    few, and each of them is worth a training of its own.

    Args:
        search: folder of a run of `evolve` or `codesign`.
        config: settings.
        run: folder of the training, by default `specialists` in that of the search. It is a run as of `train` with
            several bodies; one that exists at a path is resumed. Its `specialists.json` holds `Specialists.table`.
        progress: see `train`.
        should_stop: see `train`.
        num_threads: threads of the simulator; all cores by default. Results do not depend on it.

    Raises:
        ValueError: There is no such run, or it has no designs that were scored, or they cannot be trained so.
    """
    config = config or SpecialistConfig()
    rows, designs, settings = _plan(search, config)
    if not isinstance(run, RunFolder):
        run = RunFolder(run or Path(search) / FOLDER, asdict(settings), resume=True)
    result = train(settings, run=run, progress=progress, should_stop=should_stop, num_threads=num_threads)
    trained = apart(result, len(rows), config.ppo.selection)
    if not result.finished:
        return Specialists(rows, designs, trained.best, None, trained.env_steps)
    names = ("material", "edge_rule", "work_weight")
    options: dict[str, Any] = {name: getattr(settings, name) for name in names}
    make_env = partial(SoftRobotEnv, settings.task, num_threads=num_threads, **options)
    scores = score_alone(make_env, designs, trained.best, starts=_STARTS)
    out = Specialists(rows, designs, trained.best, scores, trained.env_steps + scores.env_steps)
    run.write_json(_TABLE, {"env_steps": out.env_steps, "designs": out.table()})
    return out


def settings_of(search: str | os.PathLike[str], config: SpecialistConfig) -> TrainConfig:
    """Returns the settings of the training of a search's specialists; errors as for `specialise`."""
    return _plan(search, config)[-1]


def _plan(
    search: str | os.PathLike[str], config: SpecialistConfig
) -> tuple[list[Mapping[str, Any]], list[Design], TrainConfig]:
    """Returns the rows of the designs that get specialists, the designs, and the settings of the training."""
    record = RunRecord.read(search)
    if record.kind != "codesign":
        raise ValueError(f"search: {search} is a run of {record.kind}, expected one of evolve or codesign")
    rows, is_reactive = _best_rows(record, config.count), record.material == "reactive"
    found = [record.design(dict(row)) for row in rows]
    given: dict[str, Any] = {"material": record.material or "invariant", "edge_rule": record.edge_rule}
    settings = TrainConfig(
        record.task,
        as_texts([body for body, _ in found]),
        stiffness=None if is_reactive else tuple(tuple(map(tuple, field.tolist())) for _, field in found),
        work_weight=record.config.get("work_weight"),
        ppo=config.ppo.of_bodies(len(found)),
        initial=config.initial,
        **given,
    )
    return rows, [Design(body, None if is_reactive else field) for body, field in found], settings


def _best_rows(record: RunRecord, count: int) -> list[Mapping[str, Any]]:
    """Returns the rows of a search's best designs, the best first, no two of the same body.

    Those of an evolution that has ended are survivors, by what they are worth in the end.
    """
    weights = record.config.get("work_weight")
    survivors = [row for row in record.ranked() if row.get("event") == "evaluate"]
    ranked = sorted(survivors, key=lambda row: -worth(row, weights)) or record.ranked()
    first = dict[str, Mapping[str, Any]]()
    for row in ranked:
        first.setdefault(row["body"], row)
    if not first:
        raise ValueError(f"search: {record.path} has no design that was scored")
    return list(first.values())[:count]
