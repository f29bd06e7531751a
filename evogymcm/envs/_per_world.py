"""What Gymnasium's vector environments can be asked of each of their environments, for worlds of one engine."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from evogymcm.envs.world_readings import WorldReadings

if TYPE_CHECKING:
    from evogymcm.envs.gymnasium import GymnasiumVectorEnv


class VectorWorld(WorldReadings):
    """One world of a vector environment, with what a `GymnasiumEnv` can be asked."""

    def __init__(self, envs: "GymnasiumVectorEnv", world: int) -> None:
        super().__init__(envs.engine, world)
        self._envs = envs
        self.observation_space, self.action_space = envs.single_observation_space, envs.single_action_space
        self.render_mode, self.metadata = envs.render_mode, envs.metadata

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of the vector environment."""
        return self._envs.spec

    def render(self) -> np.ndarray | None:
        """Returns a picture of this world, None where no `render_mode` was given."""
        return self._envs.picture(self._world)


class PerWorld:
    """Methods of Gymnasium's vector environments that speak to each world.

    Attributes:
        worlds: The worlds.
    """

    worlds: Sequence[VectorWorld]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Returns for each world what its method of that name returns, or its attribute: those of `GymnasiumEnv`."""
        found = [getattr(world, name) for world in self.worlds]
        return tuple(each(*args, **kwargs) if callable(each) else each for each in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns an attribute of each world."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Sets an attribute of each world: a list or tuple holds one value for each, another value is set for all.

        Raises:
            ValueError: There are not as many values as worlds.
        """
        values = values if isinstance(values, list | tuple) else [values] * len(self.worlds)
        if len(values) != len(self.worlds):
            raise ValueError(f"values: got {len(values)}, expected one for each of {len(self.worlds)} worlds")
        for world, value in zip(self.worlds, values, strict=True):
            setattr(world, name, value)
