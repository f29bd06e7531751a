"""A tiny stand-in for SoftRobotEnv: same specs, no physics; bodies advance when their actuators swing together."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

FEATURES, TASK_FEATURES, VOXEL = 20, 4, 0.1
_CHANGING = ("x", "speed", "score", "ret", "steps", "reached", "acted", "stiff")  # what a step changes
SMALL = np.array([[3, 1, 3], [4, 0, 4]])
WIDE = np.array([[3, 2, 4, 3], [4, 0, 0, 3], [1, 0, 0, 1]])


@dataclass(frozen=True)
class ToyTask:
    """Walk to x = goal_x."""

    id: str = "Toy-v0"
    time_limit: int = 40
    goal_x: float = 1.0
    goal_bonus: float = 1.0

    def score_ceiling(self, x: NDArray[np.float64]) -> NDArray[np.float64] | None:
        return self.goal_x - x


def _pad(grid: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    padded = np.zeros(shape, dtype=np.int64)
    padded[: grid.shape[0], : grid.shape[1]] = grid
    return padded


class ToyEnv(EnvBase):
    """Every world's speed is how well its actuators follow a wave that travels along the columns.

    Stiffness helps where it is high: the reactive setting can walk faster.
    """

    def __init__(
        self,
        task: ToyTask | None = None,
        *,
        bodies: NDArray[np.int64] | Sequence[NDArray[np.int64]] = SMALL,
        num_worlds: int = 4,
        material: str = "reactive",
        seed: int = 0,
        grid_shape: tuple[int, int] | None = None,
        noise: float = 0.0,
    ) -> None:
        super().__init__(batch_size=[num_worlds])
        self.task, self.material, self.noise = task or ToyTask(), material, noise
        self.bodies = [bodies] if isinstance(bodies, np.ndarray) else list(bodies)
        self.grid_shape = grid_shape or tuple(np.max([body.shape for body in self.bodies], axis=0).tolist())
        grids = [_pad(self.bodies[i % len(self.bodies)], self.grid_shape) for i in range(num_worlds)]
        self.types = np.stack(grids).reshape(num_worlds, -1)
        self.occupancy, self.actuators = self.types > 0, self.types >= 3
        self.voxel_features, self.num_designs = FEATURES, len(self.bodies)
        self._static = np.stack([self._constant_features(i) for i in range(num_worlds)])
        n, v = self.types.shape
        self.x, self.speed = np.zeros(n), np.zeros(n)
        self.score, self.ret, self.steps = np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.int64)
        self.reached = np.zeros(n, dtype=bool)
        self.acted, self.stiff = np.ones((n, v)), np.ones((n, v))
        self._make_specs(n, v)
        self.set_seed(seed)

    def _make_specs(self, n: int, v: int) -> None:
        def flag(*shape: int) -> Categorical:
            return Categorical(2, shape=(n, *shape), dtype=torch.bool)

        self.observation_spec = Composite(
            voxels=Unbounded((n, v, FEATURES)),
            types=Categorical(5, shape=(n, v, 5), dtype=torch.uint8),
            task=Unbounded((n, TASK_FEATURES)),
            occupancy=flag(v),
            actuators=flag(v),
            score=Unbounded((n, 1), dtype=torch.float64),
            unstable=flag(1),
            reached=flag(1),
            com=Unbounded((n, 2), dtype=torch.float64),
            shape=[n],
        )
        self.observation_spec["return"] = Unbounded((n, 1), dtype=torch.float64)
        heads = {"actuation": Bounded(0.6, 1.6, (n, v))}
        if self.material == "reactive":
            heads["stiffness"] = Bounded(0.5, 2.0, (n, v))
        self.action_spec = Composite(action=Composite(heads, shape=[n]), shape=[n])
        self.reward_spec = Unbounded((n, 1))
        self.done_spec = Composite(done=flag(1), terminated=flag(1), truncated=flag(1), shape=[n])

    def _constant_features(self, world: int) -> NDArray[np.float32]:
        """Grid position within the body's own array."""
        rows, cols = self.bodies[world % len(self.bodies)].shape
        features = np.zeros((*self.grid_shape, FEATURES), dtype=np.float32)
        features[..., 18] = (np.linspace(-1, 1, rows)[np.arange(self.grid_shape[0]) % rows])[:, None]
        features[..., 19] = np.linspace(-1, 1, cols)[np.arange(self.grid_shape[1]) % cols]
        return features.reshape(-1, FEATURES)

    def _all_types(self) -> NDArray[np.uint8]:
        """Own type and that of the neighbours above, right, below, left."""
        grid = np.pad(self.types.reshape(-1, *self.grid_shape), ((0, 0), (1, 1), (1, 1)))
        sides = (grid[:, 1:-1, 1:-1], grid[:, :-2, 1:-1], grid[:, 1:-1, 2:], grid[:, 2:, 1:-1], grid[:, 1:-1, :-2])
        types = np.stack(sides, -1) * (sides[0] > 0)[..., None]
        return types.reshape(*self.types.shape, 5).astype(np.uint8)

    @property
    def score_ceiling(self) -> NDArray[np.float64]:
        """Largest possible scores of a start at the mean place, NaN where not known."""
        ceiling = self.task.score_ceiling(np.zeros(len(self.x)))
        return np.full(len(self.x), np.nan) if ceiling is None else ceiling

    def _set_seed(self, seed: int | None) -> None:
        self.rng = np.random.default_rng(seed)

    def _target(self) -> NDArray[np.float64]:
        """Best actuation of every voxel now."""
        return 1.1 + 0.4 * np.sin(0.5 * self.steps[:, None] + 2 * self._static[..., 19])

    def _observation(self) -> dict[str, Any]:
        n, v = self.types.shape
        voxels = self._static.copy()
        corners = VOXEL / 2 * np.array([-1, 1, 1, 1, -1, -1, 1, -1]).reshape(4, 2)  # TL TR BL BR
        centre = 3 * VOXEL * np.stack([self._static[..., 19], -self._static[..., 18]], -1)
        voxels[..., :8] = (centre[..., None, :] + corners * self.acted[..., None, None]).reshape(n, v, 8)
        voxels[..., 8:16] = self.rng.normal(0, 0.1, (n, v, 8))
        voxels[..., 16], voxels[..., 17] = self.stiff, self.acted
        voxels *= self.occupancy[..., None]
        phase = 0.5 * self.steps
        task = np.stack([100 * self.speed, np.sin(phase), np.cos(phase), np.ones(n)], -1).astype(np.float32)
        com = np.stack([self.x, np.full(n, 0.5)], -1)
        arrays = {
            "voxels": voxels,
            "types": self._all_types(),
            "task": task,
            "occupancy": self.occupancy.copy(),
            "com": com,
        }
        arrays |= {"actuators": self.actuators.copy(), "unstable": np.zeros((n, 1), dtype=bool)}
        arrays["reached"] = self.reached[:, None].copy()
        arrays |= {"score": self.score[:, None].copy(), "return": self.ret[:, None].copy()}
        return {name: torch.from_numpy(array) for name, array in arrays.items()}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        mask = np.ones(len(self.x), dtype=bool)
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(-1).numpy()
        self.x[mask] = self.noise * self.rng.standard_normal(int(mask.sum()))
        for array in (self.speed, self.score, self.ret, self.steps, self.reached):
            array[mask] = 0
        self.acted[mask], self.stiff[mask] = 1, 1
        return TensorDict(self._observation(), batch_size=self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        before = {name: getattr(self, name) for name in _CHANGING}
        action = tensordict["action"].detach()
        self.acted = np.clip(action["actuation"].numpy().astype(np.float64), 0.6, 1.6)
        if self.material == "reactive":
            self.stiff = np.clip(action["stiffness"].numpy().astype(np.float64), 0.5, 2.0)
        error = (np.abs(self.acted - self._target()) * self.actuators).sum(-1) / self.actuators.sum(-1)
        bounce = (self.stiff * self.occupancy).sum(-1) / self.occupancy.sum(-1)
        self.speed = 0.03 * (0.25 - error) / 0.25 + 0.01 * (bounce - 1)
        self.x = self.x + self.speed
        self.steps = self.steps + 1
        goal = self.reached = self.x > self.task.goal_x
        reward = self.speed + self.task.goal_bonus * goal
        truncated = self.steps >= self.task.time_limit
        self.ret = self.ret + reward
        self.score = np.where(goal | truncated, self.score, self.score + reward)
        if "_step" in tensordict.keys():  # the others wait
            chosen = tensordict["_step"].numpy()
            reward = np.where(chosen, reward, 0.0)
            for name, old in before.items():
                new = getattr(self, name)
                setattr(self, name, np.where(chosen.reshape(-1, *[1] * (new.ndim - 1)), new, old))
            goal, truncated = self.reached, self.steps >= self.task.time_limit
        flags = {"terminated": goal, "truncated": truncated, "done": goal | truncated}
        out = self._observation() | {name: torch.from_numpy(flag)[:, None] for name, flag in flags.items()}
        out["reward"] = torch.from_numpy(reward.astype(np.float32))[:, None]
        return TensorDict(out, batch_size=self.batch_size)

    def get_extra_state(self) -> dict[str, Any]:
        """All that changes, so that `state_dict` restores an env exactly."""
        state = {name: torch.from_numpy(getattr(self, name).copy()) for name in _CHANGING}
        return state | {"rng": self.rng.bit_generator.state}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            if name == "rng":
                self.rng.bit_generator.state = value
            else:
                setattr(self, name, value.numpy().copy())
