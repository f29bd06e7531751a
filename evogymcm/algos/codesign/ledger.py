"""The table of a co-design run, and the controllers that it goes on with."""

from collections.abc import Collection, Mapping
from typing import Any

from evogymcm.algos.codesign.design import Individual
from evogymcm.algos.codesign.inner_loop import Policy
from evogymcm.algos.runs.folder import RunFolder

__all__ = ["Ledger"]


class Ledger:
    """Rows of all that happened to individuals, the controllers and returns of those alive, and the best so far.

    Args:
        run: where rows and controllers are kept as well; None keeps them in memory.

    Attributes:
        policies: controllers by index that are in memory, see `policy` and `keep`.
        returns: of the same, with the last step's reward, which fitness leaves out.
        rows: the table.
        champion: the best individual so far with its controller, None before there is one.
    """

    def __init__(self, run: RunFolder | None = None) -> None:
        self.run = run
        self.policies: dict[int, Policy] = {}
        self.returns: dict[int, float] = {}
        self.rows: list[dict[str, Any]] = []
        self.champion: tuple[Individual, Policy] | None = None

    @property
    def best(self) -> float | None:
        """The best fitness so far, None before there is one."""
        return None if self.champion is None else self.champion[0].fitness

    def policy(self, index: int) -> Policy:
        """Returns an individual's controller, from memory or from the folder.

        Raises:
            KeyError: It was forgotten.
        """
        if index not in self.policies and self.run and (saved := self.run.load(f"policy-{index:04}")):
            return saved
        return self.policies[index]

    def add(self, event: str, individual: Individual, generation: int, env_steps: int) -> None:
        """Adds a row for an individual with fitness, and stores its controller.

        Args:
            event: "train", "search" or "finetune".
            individual: its policy and return are there already.
            generation: in which it happened.
            env_steps: of all kinds, simulated so far.
        """
        assert individual.fitness is not None
        policy = self.policies[individual.index]
        if self.best is None or individual.fitness > self.best:
            self.champion = (individual, policy)
        row = individual.record() | {"event": event, "generation_now": generation, "env_steps": env_steps}
        row |= {"return": self.returns[individual.index], "best": self.best}
        self.rows.append(row)
        if self.run:
            self.run.append(row)
            self.run.save(f"policy-{individual.index:04}", policy)

    def keep(self, indices: Collection[int]) -> None:
        """Forgets the controllers and returns of all others; the folder keeps theirs, for `policy`."""
        self.policies = {index: policy for index, policy in self.policies.items() if index in indices}
        self.returns = {index: value for index, value in self.returns.items() if index in indices}

    def state_dict(self) -> dict[str, Any]:
        """Returns all but the rows, of which the folder has as many as are counted here, or more."""
        champion = None
        if self.champion:
            champion = {"individual": self.champion[0].record(), "policy": self.champion[1]}
        return {
            "rows": len(self.rows),
            "policies": self.policies,
            "returns": self.returns,
            "champion": champion,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from where `state_dict` was called; rows that the folder has got since are dropped."""
        assert self.run is not None
        self.run.keep_rows(state["rows"])
        self.rows = self.run.rows()
        self.policies, self.returns = dict(state["policies"]), dict(state["returns"])
        if state["champion"]:
            individual = Individual.from_record(state["champion"]["individual"])
            self.champion = (individual, state["champion"]["policy"])
