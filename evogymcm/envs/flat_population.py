"""A population as agents with one vector each way, whose episodes begin together, for libraries on TorchRL."""

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from evogymcm._messages import brief
from evogymcm.envs.actions import RANGES
from evogymcm.envs.adapter import Adapter
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import BodySpec, as_bodies
from evogymcm.envs.options import EngineOptions, complete, lists_options
from evogymcm.envs.population import GROUP
from evogymcm.envs.render.renderer import Renderer
from evogymcm.envs.task import Task


class FlatPopulationEnv(Adapter, EnvBase):
    """C copies of a population of P bodies, each alone in its own world; batch size [C].

    An episode is one of the whole population: a body that ends early waits, with reward 0 and its flags set, until all
    have ended, which is what `"done"` says. (In `PopulationEnv` every body restarts by itself.)

    | key | shape | what |
    | --- | --- | --- |
    | `("bodies", "observation")` | [C, P, D] float32 | as of `BodiesParallelEnv` with `flat=True` |
    | `("bodies", "action")` | [C, P, V], or [C, P, 2 V] in the reactive setting | actuation, then stiffness |
    | `("bodies", "reward")` | [C, P, 1] | |
    | `("bodies", "done")` and `"terminated"`, `"truncated"` | [C, P, 1] bool | whether the body has ended |
    | `"done"` and `"terminated"`, `"truncated"` | [C, 1] bool | whether all have; terminated if none was cut |

    Args:
        task: A task or its id.
        bodies: The P bodies.
        copies: C.
        device: Where tensors go; the simulator runs on the CPU.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape, work_weight and seed, as all
            environments take them: see `EngineOptions`.

    Raises:
        ValueError: For bad arguments, as `TaskEngine`; in a step for an action of a wrong shape or with NaN.
    """

    _has_frame_skip = True  # 30 substeps an env-step are ours, not a transform's

    @lists_options
    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec],
        copies: int = 1,
        *,
        device: torch.device | str | None = None,
        **options: Unpack[EngineOptions],
    ) -> None:
        if copies < 1:
            raise ValueError(f"copies: got {copies}, at least 1 is needed")
        designs = as_bodies(bodies)
        self._shape = copies, len(designs)
        engine = TaskEngine(task, designs, copies * len(designs), with_flat=False, **options)
        super().__init__(device=device, batch_size=[copies])
        self.engine = engine
        self.group_map = {GROUP: [f"body_{i}" for i in range(len(designs))]}
        self._renderer: Renderer | None = None
        self._make_specs()
        engine.set_seed(complete(options)["seed"])  # the first reset begins with it too

    def _make_specs(self) -> None:
        device, n_cells = self.device, self.engine.occupancy.shape[1]

        def grouped(**of_bodies: Any) -> Composite:
            group = Composite(of_bodies, shape=self._shape, device=device)
            return Composite({GROUP: group}, shape=self.batch_size, device=device)

        def flags(*shape: int) -> dict[str, Categorical]:
            names = ("done", "terminated", "truncated")
            return {name: Categorical(2, shape=(*shape, 1), dtype=torch.bool, device=device) for name in names}

        low, high = np.repeat(np.array([RANGES[head] for head in self._heads], np.float32), n_cells, axis=0).T
        limits = [torch.from_numpy(limit.copy()).expand(*self._shape, -1).clone() for limit in (low, high)]
        size = (*self._shape, self.engine.vectors().shape[1])
        self.observation_spec = grouped(observation=Unbounded(size, device=device))
        self.action_spec = grouped(action=Bounded(*limits, device=device))
        self.reward_spec = grouped(reward=Unbounded((*self._shape, 1), device=device))
        self.done_spec = grouped(**flags(*self._shape)).update(flags(self._shape[0]))

    def _pack(self, **of_bodies: np.ndarray) -> TensorDict:
        """Returns what there is for each world, under the group, and the flags."""
        engine = self.engine
        of_bodies |= {"observation": engine.vectors(), "terminated": engine.terminated, "truncated": engine.truncated}
        of_bodies["done"] = engine.terminated | engine.truncated
        group = {name: torch.from_numpy(values.reshape(*self._shape, -1).copy()) for name, values in of_bodies.items()}
        done = group["done"].all(1)
        terminated = done & group["terminated"].all(1)
        packed = {GROUP: TensorDict(group, self._shape), "done": done, "terminated": terminated}
        return TensorDict(packed | {"truncated": done & ~terminated}, self.batch_size, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        mask = None
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(-1).cpu().numpy().repeat(self._shape[1])
        self.engine.reset(mask)
        return self._pack()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        engine = self.engine
        n_worlds, n_cells = engine.occupancy.shape
        action = tensordict.get((GROUP, "action"), None)
        wanted = (*self._shape, len(self._heads) * n_cells)
        if not isinstance(action, torch.Tensor) or action.shape != wanted:
            got = f"shape {tuple(action.shape)}" if isinstance(action, torch.Tensor) else brief(action)
            raise ValueError(f"action: got {got}, expected a tensor {wanted} under {(GROUP, 'action')}")
        parts = action.detach().cpu().numpy().reshape(n_worlds, len(self._heads), n_cells)
        going = ~(engine.terminated | engine.truncated)
        chosen = tensordict.get("_step", None)  # TorchRL's flag of the copies to advance
        if chosen is not None:
            going &= chosen.reshape(-1).cpu().numpy().repeat(self._shape[1])
        given = dict(zip(self._heads, parts.swapaxes(0, 1), strict=True))
        engine.step(given["actuation"], given.get("stiffness"), None if going.all() else going)
        return self._pack(reward=engine.reward.astype(np.float32))

    def render(self, width: int = 640, height: int = 320, view: str = "types") -> np.ndarray:
        """Returns a picture of the bodies of the first copy, uint8 (height, width, 3), see `Renderer.grid`."""
        asked = width, height, view
        if self._renderer is None or (self._renderer.width, self._renderer.height, self._renderer.view) != asked:
            self._renderer = Renderer(self.engine, *asked)
        return self._renderer.grid(list(range(self._shape[1])))

    def _set_seed(self, seed: int | None) -> None:
        self.engine.set_seed(seed)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Ends the simulator's threads; a later step starts them again."""
        self.engine.close()
        super().close(raise_if_closed=raise_if_closed)
