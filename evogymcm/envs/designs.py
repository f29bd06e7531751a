"""Designs as they are given: bodies and stiffness fields, checked, and dealt to worlds on the padded grid."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm.body import Body, as_body, check_stiffness

MATERIALS = ("invariant", "reactive")

BodySpec = Body | str | np.ndarray | Sequence[Any]


def as_bodies(bodies: Any) -> list[Body]:
    """Returns the bodies of one body or of a list or tuple of them.

    A list is one body where it is made of rows: strings of cells, or sequences of codes.

    Raises:
        ValueError: For an empty list, or a body that is not valid.
    """
    if isinstance(bodies, Body | str) or (isinstance(bodies, np.ndarray) and bodies.ndim == 2):
        return [as_body(bodies)]
    items = list(bodies)
    if not items:
        raise ValueError("bodies: got none, at least one is needed")
    if all(np.ndim(item) == 1 and not isinstance(item, Body | str) for item in items):
        return [as_body(items)]
    return [as_body(item) for item in items]


def on_grid(values: np.ndarray, grid_shape: tuple[int, int], fill: Any) -> np.ndarray:
    """Returns (V,) a body's (rows, columns) values in the upper left corner of the padded grid, `fill` elsewhere."""
    grid = np.full(grid_shape, fill, values.dtype)
    grid[: values.shape[0], : values.shape[1]] = values
    return grid.ravel()


def deal_fields(
    stiffness: Any, designs: Sequence[Body], material: str, n_worlds: int, grid_shape: tuple[int, int]
) -> np.ndarray | None:
    """Returns (N, V) stiffness fields of the worlds, dealt like the bodies; None for 1 everywhere.

    Args:
        stiffness: None, a field of the one body's shape, or a list of as many fields (or None) as bodies.
        designs: The bodies.
        material: "invariant" or "reactive".
        n_worlds: N.
        grid_shape: (rows, columns) of the padded grid.

    Raises:
        ValueError: Where fields are given in the reactive setting, are not as many as bodies, or are not valid.
    """
    if stiffness is None:
        return None
    if material == "reactive":
        raise ValueError("stiffness: in the reactive setting it is part of the action and cannot be given here")
    one_each = isinstance(stiffness, list | tuple) and len(stiffness) == len(designs)
    if len(designs) > 1 and not one_each:
        raise ValueError(f"stiffness: {len(designs)} bodies need a list of as many fields (or None)")
    given = list(stiffness) if one_each and np.ndim(stiffness[0]) != 1 else [stiffness]
    fields = [on_grid(check_stiffness(f, body), grid_shape, 1.0) for f, body in zip(given, designs, strict=True)]
    return np.stack([fields[i % len(fields)] for i in range(n_worlds)])
