"""Which design each world of an engine begins with: dealt from a list in turn, or the next ones of a stream."""

from collections.abc import Sequence

import numpy as np

from evogymcm._settings import check_count
from evogymcm.body import Body
from evogymcm.envs.dealing import BodySpec, as_bodies, check_grid_shape, deal_fields
from evogymcm.envs.options import EngineOptions
from evogymcm.envs.streams import BodySource, BodyStream, is_source


class Lineup:
    """The designs that an engine is made with.

    Args:
        bodies: A body, a list of bodies, or a stream.
        num_worlds: N; as many as bodies by default, 1 under a stream.
        options: The engine's, all of them.

    Attributes:
        stream: The stream, to be seeded before the first designs are dealt; None where bodies are listed.
        num_worlds: N.
        num_designs: How many bodies were given, N under a stream.
        grid_shape: (rows, columns) of the padded grid.

    Raises:
        ValueError: For a body that is invalid or does not fit in the grid, no world, or stiffness beside a stream.
    """

    stream: BodyStream | None = None

    def __init__(
        self, bodies: BodySpec | Sequence[BodySpec] | BodySource, num_worlds: int | None, options: EngineOptions
    ) -> None:
        self._material, self._stiffness = options["material"], options["stiffness"]
        self._designs: list[Body] = [] if is_source(bodies) else as_bodies(bodies)
        self.grid_shape = check_grid_shape(options["grid_shape"], self._designs or None)
        self.num_designs = len(self._designs) or (1 if num_worlds is None else check_count("num_worlds", num_worlds))
        self.num_worlds = self.num_designs
        if num_worlds is not None:
            self.num_worlds = check_count("num_worlds", num_worlds)
        if is_source(bodies):
            if self._stiffness is not None:
                raise ValueError("stiffness: a stream gives it with each body, as (body, stiffness)")
            self.stream = BodyStream(bodies, self.num_worlds, self.grid_shape, self._material == "invariant")

    def deal(self) -> tuple[tuple[Body, ...], np.ndarray | None]:
        """Returns the body of each world, and (N, V) stiffness fields; None for 1 everywhere."""
        n = self.num_worlds
        if self.stream is not None:
            given = self.stream.next(np.arange(n))
            return tuple(body for body, _ in given), np.stack([field for _, field in given])
        bodies = tuple(self._designs[i % self.num_designs] for i in range(n))
        return bodies, deal_fields(self._stiffness, self._designs, self._material, n, self.grid_shape)
