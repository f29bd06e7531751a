"""Settings of an evolution of bodies with their gaits: plain data, without torch or numba."""

from dataclasses import dataclass

from evogymcm._settings import (
    EdgeRule,
    Material,
    WorkWeight,
    check_count,
    check_fields,
    check_numbers,
    check_pair,
    check_work_weight,
)
from evogymcm.body import SAMPLE_WEIGHTS, STIFFNESS_HIGH, STIFFNESS_LOW, check_weights

_BOUNDS: dict[str, dict[str, float]] = {  # counts without any: from 1
    "stiffness": {"low": STIFFNESS_LOW, "high": STIFFNESS_HIGH},
    "first": {"low": 2},
    "survivors": {"low": 2},
    "body_rate": {"above": 0, "high": 1},
    "gait_rate": {"above": 0, "high": 1},
    "stiffness_rate": {"above": 0, "high": 1},
    "mutation_rate": {"above": 0, "high": 1},
    "sparsest": {"low": 1},
    "sigma": {"above": 0},
    "seed": {"low": 0},
}


@dataclass(frozen=True)
class EvolveConfig:
    """Everything that an evolution of bodies with their gaits depends on. One set of defaults serves all tasks.

    Attributes:
        task: id of the task.
        material: "invariant" (stiffness belongs to the design) or "reactive" (it is part of the gait).
        stiffness: factor of all voxels in the invariant setting; with `evolves_stiffness` it begins at 1.
        evolves_stiffness: invariant setting only: whether each design has a stiffness field of its own, which changes
            from parent to child as in a material search.
        edge_rule: how stiffness acts on shared edges.
        work_weight: what a unit of supplied work costs in fitness: a number, or one for work of actuation and one for
            work of stiffness. None: fitness is the score. The last survivors' work is measured in any case.
        shape: rows and columns of the bodies.
        max_env_steps: the run ends with the generation that reaches as many.
        first: random bodies with random gaits in the first generation.
        candidates: children in each later one, each played for one episode (for several, where the task draws at
            random).
        survivors: designs that stay after each generation, and are the parents of the next.
        per_body: how many of them may have the same body.
        body_rate: probability that a child's body is a mutant of its parent's.
        gait_rate: probability that a child's gait is changed; always where the body is not.
        stiffness_rate: probability that a child's stiffness field is changed, where fields evolve.
        mutation_rate: probability that a cell of a mutant is drawn anew.
        attempts: attempts at a valid mutant; without success the body stays.
        weights: relative frequencies of empty, rigid, soft, horizontal and vertical cells in random bodies and in cells
            drawn anew (EvoGym's by default).
        sparsest: factor, at most, on the frequency of empty cells; each random body and each mutant draws its own
            between 1 and this. EvoGym's random bodies fill their grid, and some tasks need small ones.
        sigma: first step of gaits, where 1 is the spread of random ones; it evolves with them.
        eval_starts: starts, 1e-6 metres apart, from which the last survivors are played once more, see `evaluate`; the
            best of them is the one with the highest robust score and last reward. 1 for none but the exact one.
        seed: seed of all random draws.
        num_threads: threads of the simulator, without effect on the result; None for all cores.

    Raises:
        ValueError: A value is of the wrong kind or out of range, or values contradict each other.
    """

    task: str = "Walker-v0"
    material: Material = "invariant"
    stiffness: float = 1.0
    evolves_stiffness: bool = False
    edge_rule: EdgeRule = "mean_factor"
    work_weight: WorkWeight = None
    shape: tuple[int, int] = (5, 5)
    max_env_steps: int = 1_000_000
    first: int = 256
    candidates: int = 128
    survivors: int = 16
    per_body: int = 2
    body_rate: float = 0.6
    gait_rate: float = 0.7
    stiffness_rate: float = 0.5
    mutation_rate: float = 0.1
    attempts: int = 50
    weights: tuple[float, ...] = SAMPLE_WEIGHTS
    sparsest: float = 4.0
    sigma: float = 0.3
    eval_starts: int = 8
    seed: int = 0
    num_threads: int | None = None

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        shape = tuple(check_count("shape", side) for side in check_pair("shape", self.shape))
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "work_weight", check_work_weight(self.work_weight))
        object.__setattr__(self, "weights", check_weights(check_numbers("weights", self.weights)))
        if not isinstance(self.task, str):
            raise ValueError(f"task: got {self.task!r}, expected the id of a task")
        if self.survivors > self.first:
            raise ValueError(f"survivors: got {self.survivors}, expected 2 to {self.first} (first)")
        if self.material == "reactive" and (self.evolves_stiffness or self.stiffness != 1.0):
            name = "evolves_stiffness" if self.evolves_stiffness else "stiffness"
            raise ValueError(f"{name}: got {getattr(self, name)}, gaits set stiffness; needs material 'invariant'")
        if self.evolves_stiffness and self.stiffness != 1.0:
            raise ValueError(f"stiffness: got {self.stiffness}, fields that evolve begin at 1")
