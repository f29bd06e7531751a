"""Numbers of the voxel physics, and the few of them that a simulator lets its user change.

Lengths are in metres (a voxel is 0.1 m wide), every point has mass 1, and time is counted in the simulator's own units,
of which a substep is 1e-4. All values are EvoGym's.
"""

from dataclasses import asdict, dataclass, fields
from typing import NamedTuple

import numpy as np

from evogymcm._grid import EMPTY as EMPTY
from evogymcm._grid import FIXED as FIXED
from evogymcm._grid import H_ACT as H_ACT
from evogymcm._grid import RIGID as RIGID
from evogymcm._grid import SOFT as SOFT
from evogymcm._grid import V_ACT as V_ACT
from evogymcm._settings import check_number
from evogymcm.body import STIFFNESS_HIGH as STIFFNESS_HIGH
from evogymcm.body import STIFFNESS_LOW as STIFFNESS_LOW

VOXEL = 0.1  # metres, the side of a voxel
SUBSTEPS = 30  # integration steps in one env-step
MISSING = -1  # "there is none", in every index array
N_CODES = FIXED + 1  # voxel codes

ACTUATION_LOW, ACTUATION_HIGH = 0.6, 1.6

STRETCH_LIMIT, SQUEEZE_LIMIT = 1.25, 0.75  # of the initial length: every spring, corrected by LIMIT_GAIN
LIMIT_GAIN = 0.8
RIGID_STRETCH_LIMIT, RIGID_SQUEEZE_LIMIT = 1.03, 0.97  # the edges of rigid voxels, corrected by RIGID_LIMIT_GAIN
RIGID_LIMIT_GAIN = 0.5

_SPRING = 3e8
# By voxel code: the constant of an edge and of a diagonal spring.
EDGE_CONSTANT = _SPRING * np.array([0.0, 1 / 3.5, 1 / 6, 1 / 5, 1 / 5, 1 / 3.5])
DIAGONAL_CONSTANT = _SPRING * np.array([0.0, 1 / 7, 1 / 24, 1 / 10, 1 / 10, 1 / 7])


class PhysicsValues(NamedTuple):
    """`Physics` as the kernels take it: plain numbers in a tuple."""

    substep: float
    gravity: float
    drag: float
    convergence: float
    ground_stiffness: float
    ground_friction_gain: float
    contact_stiffness: float
    contact_offset: float
    contact_damping: float
    friction: float
    friction_gain: float


@dataclass(frozen=True)
class Physics:
    """Constants of a simulator; the defaults are the benchmark's.

    Attributes:
        substep: Integration step, in simulator time.
        gravity: Acceleration along -y.
        drag: Viscous drag of a point, on its integrated velocity.
        convergence: Fraction of a spring's distance to its goal by which its rest length leads, per substep.
        ground_stiffness: Penalty of the implicit floor y = 0.
        ground_friction_gain: Friction gain of the implicit floor.
        contact_stiffness: Penalty of contact between voxels.
        contact_offset: Metres added to every contact depth.
        contact_damping: Damping of the normal velocity in contact.
        friction: Friction coefficient, of the floor and of contacts.
        friction_gain: Friction gain of contact between voxels.

    Raises:
        ValueError: A value is not finite or is negative, or the substep is not positive.
    """

    substep: float = 1e-4
    gravity: float = 110.0
    drag: float = 0.1
    convergence: float = 0.006
    ground_stiffness: float = 1.4e7
    ground_friction_gain: float = 10.0
    contact_stiffness: float = 2.1e6
    contact_offset: float = 0.005
    contact_damping: float = 140.0
    friction: float = 0.2
    friction_gain: float = 1200.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            bounds = {"gravity": {}, "substep": {"above": 0.0}}.get(name, {"low": 0.0})
            object.__setattr__(self, name, check_number(f"physics {name}", value, **bounds))

    def changed(self) -> dict[str, float]:
        """Returns the values that differ from the benchmark's, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    def values(self) -> PhysicsValues:
        """Returns the constants as the kernels take them."""
        return PhysicsValues(**{name: float(value) for name, value in asdict(self).items()})
