"""The table of a co-design run, and the policies that it goes on with."""

from collections.abc import Collection, Mapping
from typing import Any

from evogymcm._settings import WORK
from evogymcm.algos.codesign.design import Individual
from evogymcm.algos.codesign.inner_loop import Policy
from evogymcm.algos.runs.folder import RunFolder

_TOLD = ("return", "score", "robust_score", "spread", *WORK)  # see `Scores.row`


class Ledger:
    """Rows of all that happened to individuals, their policies, and the best individual so far.

    A policy lies in the folder once, as `policy-0007.pt`. It may be newer than the state that a killed run goes on
    from: only fine-tuning replaces policies, and a fine-tuning that has ended is then repeated from its own checkpoint.

    Args:
        run: where rows and policies are kept; None keeps them in memory.

    Attributes:
        rows: the table.
        champion: the best individual so far, None before there is one; its stored policy is the one that it was best
            with, since no policy gives way to a worse one.
    """

    def __init__(self, run: RunFolder | None = None) -> None:
        self.run = run
        self.rows: list[dict[str, Any]] = []
        self.champion: Individual | None = None
        self._policies: dict[int, Policy] = {}  # without a folder
        self._told: dict[int, dict[str, float]] = {}  # of each individual besides its record, such as the return

    @property
    def best(self) -> float | None:
        """The best fitness so far, None before there is one."""
        return None if self.champion is None else self.champion.fitness

    def policy(self, index: int) -> Policy:
        """Returns an individual's policy."""
        saved = self.run.load(_name(index)) if self.run else self._policies.get(index)
        if saved is None:
            raise KeyError(f"there is no policy of individual {index}")
        return saved

    def store(self, index: int, policy: Policy) -> None:
        """Keeps an individual's policy in place of the one that it had."""
        if self.run:
            self.run.save(_name(index), policy)
        else:
            self._policies[index] = policy

    def add(
        self,
        event: str,
        individual: Individual,
        generation: int,
        env_steps: int,
        told: Mapping[str, float] | None,
    ) -> None:
        """Adds a row for an individual with fitness, as it is after an event: "train", "search" or "finetune".

        `env_steps` are all that are simulated so far; `told` is its return, and scores from several starts, see
        `Scores.row`; None for those that it had.
        """
        assert individual.fitness is not None
        if self.best is None or individual.fitness > self.best:
            self.champion = individual
        if told is not None:
            self._told[individual.index] = dict(told)
        row = individual.record() | {"event": event, "generation_now": generation, "env_steps": env_steps}
        row |= self._told[individual.index] | {"best": self.best}
        self.rows.append(row)
        if self.run:
            self.run.append(row)

    def keep(self, indices: Collection[int]) -> None:
        """Forgets all other policies but the champion's; a folder keeps those of all."""
        kept = {*indices} | ({self.champion.index} if self.champion else set())
        self._policies = {index: policy for index, policy in self._policies.items() if index in kept}

    def state_dict(self) -> dict[str, Any]:
        """Returns what says how far the folder's table and policies count."""
        champion = {"individual": self.champion.record()} if self.champion else None
        return {"rows": len(self.rows), "champion": champion}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from where `state_dict` was called; rows that the folder has got since are dropped."""
        assert self.run is not None
        self.run.keep_rows(state["rows"])
        self.rows = self.run.rows()
        self._told = {row["index"]: {name: row[name] for name in _TOLD if name in row} for row in self.rows}
        self.champion = Individual.from_record(state["champion"]["individual"]) if state["champion"] else None


def _name(index: int) -> str:
    return f"policy-{index:04}"
