"""Streams of bodies: worlds that get another body in each episode."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeGuard

import numpy as np

from evogymcm._messages import brief
from evogymcm.body import Body, as_body, check_stiffness
from evogymcm.envs.dealing import BodySpec, is_row, on_grid
from evogymcm.envs.states import checked_arrays, checked_part, checked_rngs

Given = BodySpec | tuple[BodySpec, Any]  # a body, or a body and its stiffness field
BodySource = Callable[[np.random.Generator], Given] | Iterator[Given]


def is_source(bodies: Any) -> TypeGuard[BodySource]:
    """Returns whether bodies come one after another: from a callable or an iterator."""
    return callable(bodies) or hasattr(bodies, "__next__")


class BodyStream:
    """Gives N worlds one body after another.

    A callable draws each from the world's own generator, which is there for nothing else: the bodies of a world follow
    from its seed, whatever other worlds, the task or the policy do. An iterator gives the next body to whichever world
    asks first, takes no seed, and its place cannot be saved.

    Args:
        source: `draw(rng)`, or an iterator. Each body is anything that `as_body` takes, or (body, stiffness).
        n_worlds: N.
        grid_shape: (rows, columns) that bodies must fit in.
        takes_stiffness: Whether stiffness may come with bodies.

    Attributes:
        is_new: (N,) bool, worlds whose body no episode has begun with.
    """

    def __init__(self, source: BodySource, n_worlds: int, grid_shape: tuple[int, int], takes_stiffness: bool) -> None:
        self._source, self._grid_shape, self._takes_stiffness = source, grid_shape, takes_stiffness
        self._n_given = 0
        self._rngs: list[np.random.Generator] = []
        self.is_new = np.zeros(n_worlds, bool)

    @property
    def _draws(self) -> bool:
        """Whether bodies are drawn by a callable."""
        return callable(self._source)

    def set_seed(self, seeds: Sequence[int | None]) -> None:
        """Seeds each world's generator. The next reset then draws anew."""
        self._rngs = [np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0]) for seed in seeds]
        if self._draws:
            self.is_new[:] = False

    def next(self, worlds: np.ndarray) -> list[tuple[Body, np.ndarray]]:
        """Returns the next body of each of the worlds, and its (V,) stiffness field.

        Raises:
            ValueError: For a body that is not valid or larger than the grid, a stiffness that does not fit or is not
                taken, and where the stream has ended.
        """
        return [self._read(self._ask(world)) for world in worlds.tolist()]

    def _ask(self, world: int) -> Given:
        try:
            given = self._source(self._rngs[world]) if callable(self._source) else next(self._source)
        except StopIteration:
            raise ValueError(
                f"bodies: the stream has ended after {self._n_given}; give one without an end, such as itertools.cycle"
            ) from None
        self._n_given += 1
        return given

    def _read(self, given: Any) -> tuple[Body, np.ndarray]:
        stiffness = None
        if isinstance(given, tuple) and len(given) == 2 and not all(is_row(part) for part in given):
            given, stiffness = given
        try:
            body = as_body(given)
            if stiffness is not None and not self._takes_stiffness:
                raise ValueError("stiffness: in the reactive setting it is part of the action")
            field = np.ones(body.shape) if stiffness is None else check_stiffness(stiffness, body)
        except (ValueError, TypeError) as error:
            raise ValueError(f"bodies: the stream gave {brief(given)}: {error}") from error
        self._check_size(body)
        return body, on_grid(field, self._grid_shape, 1.0)

    def _check_size(self, body: Body) -> None:
        rows, columns = self._grid_shape
        if body.rows > rows or body.cols > columns:
            raise ValueError(
                f"bodies: the stream gave {brief(body.text)} of shape {body.shape}, larger than grid_shape "
                f"{self._grid_shape}"
            )

    def state(self) -> dict[str, Any]:
        """Returns where the stream is, for `checked`; ValueError where that is known to an iterator only."""
        if not self._draws:
            raise ValueError("state: the place of an iterator cannot be saved; give bodies=draw, called as draw(rng)")
        return {"rngs": [rng.bit_generator.state for rng in self._rngs], "is_new": self.is_new.copy()}

    def checked(self, state: Any) -> tuple[dict[str, Any], list[Body]]:
        """Returns what `take_up` takes, and the bodies that the worlds had, packed under "bodies".

        Raises:
            ValueError: The state is of other worlds, or bodies come from an iterator.
        """
        if not self._draws:
            raise ValueError("state: bodies come from an iterator, whose place cannot be set")
        place = {"_rngs": checked_rngs(state, self._rngs), **checked_arrays(state, {"is_new": self.is_new})}
        packed = checked_part(state, "bodies")
        if len(packed) != len(self.is_new):
            raise ValueError(f"state: 'bodies' are {len(packed)}, expected {len(self.is_new)}")
        bodies = unpack_bodies(packed)
        for body in bodies:
            self._check_size(body)
        return place, bodies

    def take_up(self, place: dict[str, Any]) -> None:
        """Goes on from where `state` was called."""
        self._rngs, self.is_new = place["_rngs"], place["is_new"]


def pack_bodies(bodies: Sequence[Body]) -> list[list[np.ndarray]]:
    """Returns bodies as arrays, for `unpack_bodies`."""
    return [[body.grid.copy(), body.connections.copy()] for body in bodies]


def unpack_bodies(packed: Sequence[Sequence[np.ndarray]]) -> list[Body]:
    """Returns the bodies that `pack_bodies` packed."""
    return [Body(grid, connections) for grid, connections in packed]
