"""What a run of co-design tells on its way and at its end."""

from dataclasses import dataclass
from typing import Any

from evogymcm.algos.codesign.design import Individual
from evogymcm.algos.codesign.inner_loop import Policy


@dataclass(frozen=True)
class CodesignProgress:
    """State of a run, told after every update of a policy and every round of a search.

    Attributes:
        generation: counted from 0.
        phase: "screen", "train", "search" or "finetune".
        env_steps: simulated so far, of all kinds.
        n_designs: bodies proposed so far.
        best: the best fitness so far, None before there is one.
    """

    generation: int
    phase: str
    env_steps: int
    n_designs: int
    best: float | None


@dataclass(frozen=True)
class CodesignResult:
    """Outcome of a run.

    Attributes:
        best: the best individual; None where the run was stopped before there was one.
        policy: its policy.
        rows: the table, see `Codesign`.
        env_steps: simulated in all.
        finished: False if it was stopped.
    """

    best: Individual | None
    policy: Policy | None
    rows: list[dict[str, Any]]
    env_steps: int
    finished: bool
