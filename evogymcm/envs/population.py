"""A population as agents: the worlds of SoftRobotEnv under groups, TorchRL's form for many agents."""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase, MarlGroupMapType
from torchrl.envs.utils import check_marl_grouping

from evogymcm._messages import brief
from evogymcm._settings import check_count
from evogymcm.body import Body
from evogymcm.envs.adapter import Adapter
from evogymcm.envs.dealing import BodySpec, as_bodies
from evogymcm.envs.options import EngineOptions, lists_options
from evogymcm.envs.streams import BodySource, is_source
from evogymcm.envs.task import Task
from evogymcm.envs.torchrl import SoftRobotEnv, check_action

GROUP = "bodies"


class PopulationEnv(Adapter, EnvBase):
    """P bodies as agents of one environment, each in its own world: same keys as `SoftRobotEnv`, under a group.

    `("bodies", "voxels")` is [P, V, F], `("bodies", "action", "actuation")` [P, V], `("bodies", "reward")` [P, 1]. Done
    flags exist in the group only, so every body ends and restarts by itself, and no body waits for another. All bodies
    always act; `occupancy` and `actuators` mask the cells that a body does not have.

    Of TorchRL's transforms, `RewardSum` must stand before `StepCounter`: by itself, `StepCounter` (0.14) declares the
    group without its agent dimension, and collectors then fail.

    With a stream of bodies, an agent that restarts gets a new body. Copies are then separate populations, with
    different bodies.

    Args:
        task: A task or its id.
        bodies: The P bodies, or a stream of them, see `TaskEngine`.
        copies: C copies of the whole population, batch size [C] and shapes [C, P, ...]; None for one, batch size [].
        device: Where tensors go; the simulator runs on the CPU.
        group_map: Which agents (`body_0` ...) form which group, or one of TorchRL's ready maps. By default all are in
            the one group `bodies`.
        num_bodies: P; required with a stream.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape, work_weight and seed, as all
            environments take them: see `EngineOptions`.

    Attributes:
        worlds: The `SoftRobotEnv` of all C * P worlds; world c * P + p is body p of copy c.
        agent_names: `body_0` ... in the order of the bodies.
        group_map: The names of each group's agents.

    Raises:
        ValueError: For bad arguments and actions, as `SoftRobotEnv`, and for groups in which an agent is missing or
            occurs twice.
    """

    _has_frame_skip = True  # 30 substeps an env-step are ours, not a transform's
    worlds: SoftRobotEnv

    @lists_options
    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec] | BodySource,
        copies: int | None = None,
        *,
        device: torch.device | str | None = None,
        group_map: MarlGroupMapType | Mapping[str, Sequence[str]] | None = None,
        num_bodies: int | None = None,
        **options: Unpack[EngineOptions],
    ) -> None:
        designs = bodies if is_source(bodies) else as_bodies(bodies)
        if isinstance(designs, list):
            number = len(designs)
            if num_bodies is not None and check_count("num_bodies", num_bodies) != number:
                raise ValueError(f"num_bodies: got {brief(num_bodies)}, allowed is {number}, the number of bodies")
        else:
            number = check_count("num_bodies (needed under a stream)", num_bodies)
        copies = None if copies is None else check_count("copies", copies)
        super().__init__(device=device, batch_size=[] if copies is None else [copies])
        self.agent_names = [f"body_{i}" for i in range(number)]
        self.group_map = self._make_groups(group_map)
        worlds = SoftRobotEnv(task, designs, number * (copies or 1), **options)
        self.engine = worlds.engine
        object.__setattr__(self, "worlds", worlds)  # no submodule: its state is saved as ours, once
        order = {name: i for i, name in enumerate(self.agent_names)}
        self._members = {group: [order[name] for name in names] for group, names in self.group_map.items()}
        self._is_whole = list(self._members.values()) == [list(range(self.num_bodies))]
        ungrouped = [member for members in self._members.values() for member in members]
        self._places = torch.tensor(ungrouped).argsort()  # of each body among the groups put side by side
        self._make_specs()

    def _make_groups(self, given: MarlGroupMapType | Mapping[str, Sequence[str]] | None) -> dict[str, list[str]]:
        if given is None:
            return {GROUP: list(self.agent_names)}
        if isinstance(given, MarlGroupMapType):
            return given.get_group_map(self.agent_names)
        groups = {group: list(names) for group, names in given.items()}
        try:
            check_marl_grouping(groups, self.agent_names)
        except ValueError as error:
            known = f"body_0 to {self.agent_names[-1]}"
            raise ValueError(
                f"group_map: got {brief(groups)}, each of {known} must be in one group: {brief(str(error))}"
            ) from error
        return groups

    def _make_specs(self) -> None:
        def grouped(spec: Composite) -> Composite:
            one = spec[0]  # all worlds have the same
            groups = {group: one.expand(*self.batch_size, len(names)) for group, names in self.group_map.items()}
            return Composite(groups, shape=self.batch_size).clone().to(self.device)

        self.observation_spec = grouped(self.worlds.observation_spec)
        self.action_spec = grouped(self.worlds.full_action_spec)
        self.reward_spec = grouped(self.worlds.full_reward_spec)
        self.done_spec = grouped(self.worlds.full_done_spec)

    @property
    def num_bodies(self) -> int:
        """P, the number of bodies."""
        return len(self.agent_names)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The P bodies; with a stream the current ones, of the first copy."""
        return self.worlds.bodies[: self.num_bodies]

    @property
    def score_ceiling(self) -> np.ndarray:
        """(P,) the largest possible scores of `bodies`, NaN where they are not known."""
        return self.worlds.score_ceiling[: self.num_bodies]

    def _group(self, rows: TensorDictBase) -> TensorDict:
        """Returns the worlds' rows under their groups."""
        if self.batch_size:
            rows = rows.reshape(*self.batch_size, self.num_bodies)
        if self._is_whole:
            (group,) = self.group_map
            groups = {group: rows}
        else:
            groups = {group: rows[..., members] for group, members in self._members.items()}
        return TensorDict(groups, batch_size=self.batch_size, device=self.device)

    def _ungroup(self, parts: list[Any]) -> Any:
        """Returns one tensor or TensorDict with a row for each world from the groups', given in their order."""
        agent_dim = len(self.batch_size)
        rows = parts[0] if self._is_whole else torch.cat(parts, agent_dim)[..., self._places]
        return rows.reshape(-1) if agent_dim else rows

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        chosen = None
        if tensordict is not None:
            flags = {group: tensordict.get((group, "_reset"), None) for group in self.group_map}
            if any(flag is not None for flag in flags.values()):
                chosen = self._chosen(flags)
        return self._group(self.worlds._reset(chosen))

    def _chosen(self, flags: Mapping[str, torch.Tensor | None]) -> TensorDict:
        """Returns what resets the flagged worlds; groups without flags go on."""
        parts = []
        for group, names in self.group_map.items():
            shape, flag = (*self.batch_size, len(names)), flags[group]
            parts.append(torch.zeros(shape, dtype=torch.bool) if flag is None else flag.reshape(shape).cpu())
        return TensorDict({"_reset": self._ungroup(parts)}, batch_size=self.worlds.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        actions = []
        for group, names in self.group_map.items():
            shape = (*self.batch_size, len(names))
            given = tensordict.get((group, "action"), None)
            parts = check_action(given, (group, "action"), self._heads, (*shape, self.engine.occupancy.shape[1]))
            actions.append(TensorDict({"action": dict(zip(self._heads, parts, strict=True))}, batch_size=shape))
        worlds, copies = self._ungroup(actions), tensordict.get("_step", None)  # TorchRL's flag of those to advance
        if copies is not None:
            chosen = copies.reshape(*self.batch_size, 1).expand(*self.batch_size, self.num_bodies)
            worlds.set("_step", chosen.reshape(self.worlds.batch_size))
        return self._group(self.worlds._step(worlds))

    def render(self, width: int = 640, height: int = 320, view: str = "types") -> torch.Tensor:
        """Returns a picture of all bodies, uint8 [height, width, 3], or with copies one of each, see `Renderer.grid`.

        Videos: `Compose(PixelRenderTransform(width=640, height=320), VideoRecorder(logger, tag))`.
        """
        renderer = self.worlds._renderer_of(width, height, view)
        worlds = np.arange(self.engine.num_worlds).reshape(-1, self.num_bodies)
        pictures = torch.from_numpy(np.stack([renderer.grid(row.tolist()) for row in worlds])).to(self.device)
        return pictures if self.batch_size else pictures[0]

    def _set_seed(self, seed: int | None) -> None:
        self.worlds._set_seed(seed)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Ends the simulator's threads; a later step starts them again."""
        self.worlds.close(raise_if_closed=raise_if_closed)
        super().close(raise_if_closed=raise_if_closed)

    def get_extra_state(self) -> dict[str, Any]:
        """Returns everything that a step can change, as tensors, for `set_extra_state`, see `SoftRobotEnv`."""
        return self.worlds.get_extra_state()

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restores a state of an environment made with the same arguments: a rollout continues exactly."""
        self.worlds.set_extra_state(state)


population_env = PopulationEnv  # the name for calls: population_env("Walker-v0", bodies)
