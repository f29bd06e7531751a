"""Travelling waves: gaits of a few numbers, the same for any body."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evogymcm.body import H_ACT
from evogymcm.envs.engines import engine_of
from evogymcm.sim.constants import ACTUATION_HIGH, ACTUATION_LOW

# Each number of a wave: its middle, and the spread of those that are worth a try.
_ACTUATION = {
    "period": (2.2, 0.4),  # logarithm of env-steps
    "along": (0.0, 0.6),  # radians a column
    "down": (0.0, 0.6),  # radians a row
    "lead": (0.0, 1.5),  # radians by which horizontal actuators are ahead of vertical ones
    "offset_h": (0.0, 0.3),  # half ranges of actuation
    "offset_v": (0.0, 0.3),
    "swing_h": (1.5, 0.8),  # half ranges of actuation; waves are clipped to the range
    "swing_v": (1.5, 0.8),
    "growth": (0.0, 0.3),  # of the wave a column
}
_STIFFNESS = {
    "level": (0.0, 0.3),  # powers of 2
    "level_along": (0.0, 0.15),  # a column
    "level_down": (0.0, 0.15),  # a row
    "pulse": (0.0, 0.5),  # swing of stiffness, in powers of 2
    "pulse_lead": (0.0, 1.5),  # radians ahead of the actuators
}
_PERIODS = (3.0, 40.0)  # env-steps
_CELLS = {  # what single voxels may have besides: the spread of what is worth a try, around 0
    "phase": 2.0,  # radians
    "offset": 0.6,  # half ranges of actuation
    "level": 0.6,  # powers of 2
}


class Waves:
    """Gaits of D designs: a wave that runs through each body, whatever the body senses.

    With t the env-steps of the episode and x, y the columns and rows from the middle of a body's grid, actuators have
    the phase 2 pi t / period + along * x + down * y (+ lead, if horizontal), and swing by the sine of it. In the
    reactive setting stiffness is 2 to the power of a level that may change along the body, and a pulse. A gait is thus
    9 or 14 numbers, stored as standard deviations from the middle of their range. Besides, every voxel may have its own
    phase and offset, and in the reactive setting its own level of stiffness.

    Open-loop waves are a baseline that learned policies are often not above (Raffin et al., 2024, "An Open-Loop
    Baseline for Reinforcement Learning Locomotion Tasks").

    An instance is a gait as `play` and `evaluate` take it: world w is driven by gait w % D.

    Args:
        values: (D, 9) numbers in the invariant setting, (D, 14) in the reactive one, see `Waves.names`.
        cells: (D, 2, rows, columns), phase and offset that voxels have besides, or (D, 3, rows, columns) with level in
            the reactive setting, in the same unit; None for nothing.

    Attributes:
        values: (D, 9) or (D, 14).
        cells: See above.

    Raises:
        ValueError: `values` or `cells` have another shape, or hold NaN.
    """

    def __init__(self, values: ArrayLike, cells: ArrayLike | None = None) -> None:
        self.values = np.array(values, np.float64)
        sizes = [self.size(material) for material in ("invariant", "reactive")]
        if self.values.ndim != 2 or not len(self.values) or self.values.shape[1] not in sizes:
            raise ValueError(f"values: got shape {self.values.shape}, expected (designs, {sizes[0]} or {sizes[1]})")
        if not np.isfinite(self.values).all():
            raise ValueError("values: got NaN or an infinite number")
        self.material = "invariant" if self.values.shape[1] == sizes[0] else "reactive"
        self.cells = None if cells is None else np.array(cells, np.float64)
        if self.cells is not None:
            self._own = self._of_cells(self.cells)
        self._numbers = np.array([list(row.values()) for row in self.settings])  # (D, 9 or 14), not in every env-step

    @staticmethod
    def names(material: str) -> tuple[str, ...]:
        """Returns what the numbers of a wave are, in their order."""
        return tuple(_ACTUATION) + (tuple(_STIFFNESS) if material == "reactive" else ())

    @staticmethod
    def size(material: str) -> int:
        """Returns how many numbers a wave has."""
        return len(Waves.names(material))

    @staticmethod
    def cell_names(material: str) -> tuple[str, ...]:
        """Returns what the numbers of single voxels are, in their order."""
        return tuple(_CELLS)[: 3 if material == "reactive" else 2]

    def _of_cells(self, cells: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns what voxels have besides in the units of the formula, (2 or 3, D, V)."""
        expected = (len(self.values), len(self.cell_names(self.material)))
        if cells.ndim != 4 or cells.shape[:2] != expected:
            raise ValueError(f"cells: got shape {cells.shape}, expected ({expected[0]}, {expected[1]}, rows, columns)")
        if not np.isfinite(cells).all():
            raise ValueError("cells: got NaN or an infinite number")
        spreads = np.array(list(_CELLS.values()))[: expected[1], None, None]
        return cells.reshape(*expected, -1).swapaxes(0, 1) * spreads

    @property
    def settings(self) -> list[dict[str, float]]:
        """Returns each design's numbers by their names, in the units of the formula; the period in env-steps."""
        parts = _ACTUATION | _STIFFNESS
        out = []
        for row in self.values:
            told = {
                name: parts[name][0] + parts[name][1] * float(value)
                for name, value in zip(self.names(self.material), row, strict=True)
            }
            told["period"] = float(np.clip(np.exp(told["period"]), *_PERIODS))
            out.append(told)
        return out

    def __call__(self, env: object) -> tuple[np.ndarray, np.ndarray | None]:
        """Returns what `TaskEngine.step` takes: (N, V) actuation, and stiffness in the reactive setting, else None.

        Raises:
            ValueError: There is no engine in `env`, it has the other material setting or another grid than `cells`, or
                its worlds are not D designs in turn.
        """
        engine = engine_of(env)
        if engine.material != self.material:
            raise ValueError(f"material: the gait is for the {self.material!r} setting, got {engine.material!r}")
        if engine.num_worlds % len(self.values):
            raise ValueError(f"env: got {engine.num_worlds} worlds, expected a multiple of {len(self.values)} gaits")
        if self.cells is not None and self.cells.shape[2:] != engine.grid_shape:
            raise ValueError(f"cells: are of a grid of {self.cells.shape[2:]}, got {engine.grid_shape}")
        told = np.tile(self._numbers[:, :, None], (engine.num_worlds // len(self.values), 1, 1)).swapaxes(0, 1)
        period, along, down, lead, offset_h, offset_v, swing_h, swing_v, growth = told[: len(_ACTUATION)]
        x, y = _places(engine)
        horizontal = engine.types[:, :, 0] == H_ACT
        clock = 2 * np.pi * engine.length[:, None] / period + along * x + down * y
        phase, offset, own_level = self._of_worlds(engine.num_worlds)
        clock = clock + phase
        wave = np.sin(clock + np.where(horizontal, lead, 0.0)) * np.where(horizontal, swing_h, swing_v)
        wave = (wave + np.where(horizontal, offset_h, offset_v)) * (1.0 + growth * x) + offset
        middle, half = (ACTUATION_HIGH + ACTUATION_LOW) / 2, (ACTUATION_HIGH - ACTUATION_LOW) / 2
        actuation = middle + half * np.clip(wave, -1.0, 1.0)
        if self.material == "invariant":
            return actuation, None
        level, level_along, level_down, pulse, pulse_lead = told[len(_ACTUATION) :]
        power = level + own_level + level_along * x + level_down * y + pulse * np.sin(clock + pulse_lead)
        return actuation, 2.0 ** np.clip(power, -1.0, 1.0)

    def _of_worlds(self, n: int) -> "list[NDArray[np.float64] | float]":
        """Returns phase, offset and level of the cells of all worlds, (N, V) each; 0 for what is not given."""
        if self.cells is None:
            return [0.0] * len(_CELLS)
        given = [np.tile(part, (n // len(part), 1)) for part in self._own]
        return [*given, *[0.0] * (len(_CELLS) - len(given))]


def _places(engine: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns columns and rows of all cells from the middle of each world's body, (N, V) each."""
    rows, columns = np.divmod(np.arange(engine.occupancy.shape[1]), engine.grid_shape[1])
    shapes = np.array([body.grid.shape for body in engine.bodies], np.float64)
    return columns - (shapes[:, 1:] - 1) / 2, rows - (shapes[:, :1] - 1) / 2
