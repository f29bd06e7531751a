"""Designs (body and stiffness), individuals of a search, and mutation. Knows no simulator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evogymcm.body import SAMPLE_WEIGHTS, Body, check_stiffness, mutate_body

Field = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """A body and its stiffness field.

    Attributes:
        body: the voxels.
        stiffness: (rows, cols) factors in [0.5, 2], 1 on empty cells, read-only; None is 1 everywhere.

    Raises:
        ValueError: The stiffness does not fit the body, see `check_stiffness`.
    """

    body: Body
    stiffness: Field | None = None

    def __post_init__(self) -> None:
        if self.stiffness is not None:
            field = check_stiffness(self.stiffness, self.body)
            field.flags.writeable = False
            object.__setattr__(self, "stiffness", field)

    @property
    def field(self) -> Field:
        """The stiffness (rows, cols), ones if `stiffness` is None."""
        return np.ones(self.body.shape) if self.stiffness is None else self.stiffness

    @property
    def key(self) -> str:
        """The body's codes as digits, row-major; equal keys are equal bodies, whatever the stiffness, as in EvoGym."""
        return "".join(str(code) for code in self.body.grid.ravel())

    def at(self, stiffness: float) -> "Design":
        """Returns the design with one stiffness on all voxels, as `CodesignConfig.stiffness` says; as it is at 1."""
        return self if stiffness == 1.0 else Design(self.body, np.where(self.body.occupancy, stiffness, 1.0))

    def record(self) -> dict[str, Any]:
        """Returns the design as JSON has it; `from_record` reads it back."""
        body = self.body
        return {
            "body": body.text,
            "connections": None if body.has_default_connections else body.connections.tolist(),
            "stiffness": None if self.stiffness is None else self.stiffness.tolist(),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Design":
        """Returns the design that `record` wrote; further keys play no part."""
        return cls(Body(record["body"], record["connections"]), record["stiffness"])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Design):
            return NotImplemented
        return self.body == other.body and np.array_equal(self.field, other.field)

    def __hash__(self) -> int:
        return hash(self.body)


@dataclass(frozen=True)
class Individual:
    """A design and its place in a search.

    Attributes:
        index: its number, counted from 0 in the order of proposal.
        design: body and stiffness.
        parent: index of the individual that it was mutated from, None for a random one.
        generation: when it was proposed, counted from 0.
        fitness: the best score of its training, None before it is told.
    """

    index: int
    design: Design
    parent: int | None = None
    generation: int = 0
    fitness: float | None = None

    def record(self) -> dict[str, Any]:
        """Returns the individual as a flat row of JSON types; `from_record` reads it back."""
        place = {name: getattr(self, name) for name in ("index", "parent", "generation", "fitness")}
        return place | self.design.record()

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Individual":
        """Returns the individual that `record` wrote."""
        names = ("parent", "generation", "fitness")
        return cls(record["index"], Design.from_record(record), *(record[name] for name in names))


def mutate_design(
    parent: Design,
    rng: np.random.Generator,
    rate: float = 0.1,
    attempts: int = 50,
    weights: Sequence[float] = SAMPLE_WEIGHTS,
) -> Design | None:
    """Returns a mutated design, or None where no attempt was valid; see `mutate_body`.

    The child has its parent's stiffness where a cell kept its type, and 1 elsewhere.
    """
    body = mutate_body(parent.body, rng, rate, attempts, weights)
    if body is None or parent.stiffness is None:
        return None if body is None else Design(body)
    return Design(body, np.where(body.grid == parent.body.grid, parent.stiffness, 1.0))
