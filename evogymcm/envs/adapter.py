"""What environments of other libraries show of their engine."""

import numpy as np

from evogymcm.body import Body
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.task import Task
from evogymcm.envs.voxels import N_FEATURES


class Adapter:
    """An environment of another library's form.

    Attributes:
        engine: The task engine of its worlds.
    """

    engine: TaskEngine

    @property
    def task(self) -> Task:
        """The task."""
        return self.engine.task

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The body of each world; with a stream the current ones."""
        return self.engine.bodies

    @property
    def num_designs(self) -> int:
        """How many bodies were given; world w holds number w modulo this. N with a stream."""
        return self.engine.num_designs

    @property
    def changes_bodies(self) -> bool:
        """Whether bodies come from a stream, so that worlds get a new one at each reset."""
        return self.engine.changes_bodies

    @property
    def grid_shape(self) -> tuple[int, int]:
        """(rows, columns) of the padded grid."""
        return self.engine.grid_shape

    @property
    def voxel_features(self) -> int:
        """F, the number of features of a voxel."""
        return N_FEATURES

    @property
    def score_ceiling(self) -> np.ndarray:
        """(N,) the largest possible scores, NaN where they are not known."""
        return self.engine.score_ceiling

    @property
    def _heads(self) -> tuple[str, ...]:
        """The names of an action's parts."""
        return ("actuation", "stiffness") if self.engine.material == "reactive" else ("actuation",)
