"""SoftRobotEnv: the task engine as a batched TorchRL environment."""

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from evogymcm._messages import brief, some
from evogymcm.envs.actions import RANGES
from evogymcm.envs.adapter import Adapter
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.dealing import BodySpec
from evogymcm.envs.options import EngineOptions, complete, lists_options
from evogymcm.envs.render.renderer import Renderer
from evogymcm.envs.streams import BodySource
from evogymcm.envs.task import Task
from evogymcm.envs.voxels import N_FEATURES, N_SIDES, N_TYPES


class SoftRobotEnv(Adapter, EnvBase):
    """N worlds of one task as one batched environment, for any mix of bodies.

    Importing TorchRL, and so this class, sets the process's start method to "spawn" if none was set before.

    Bodies are padded to the largest grid, V cells, each in the upper left corner; `occupancy` and `actuators` say which
    cells count. Numbers in other cells of an action are ignored. With TorchRL's `"_step"` ([N] bool) beside the action,
    worlds where it is false are not simulated and do not change; their reward is 0.

    | key | shape | what |
    | --- | --- | --- |
    | `("action", "actuation")` | [N, V] | in [0.6, 1.6], 1 is neutral |
    | `("action", "stiffness")` | [N, V] | in [0.5, 2]; reactive setting only |
    | `"voxels"` | [N, V, F] | what each voxel senses, see `evogymcm.envs.voxels` |
    | `"types"` | [N, V, 5] uint8 | type codes of each voxel and of its neighbours above, right, below, left; 0: none |
    | `"occupancy"`, `"actuators"` | [N, V] bool | which cells hold a voxel, an actuator |
    | `"task"` | [N, G] | COM velocity, sine and cosine of the orientation, the task's own global observations |
    | `"observation"` | [N, D] float64 | EvoGym's flat observation, where all bodies are and stay equal |
    | `"com"` | [N, 2] float64 | centre of mass, metres |
    | `"score"`, `"return"` | [N, 1] float64 | sums of the episode's rewards, without and with the last |
    | `"unstable"` | [N, 1] bool | whether the simulation broke down in this step |
    | `"reached"` | [N, 1] bool | whether this step ended the episode at a goal |
    | `"actuation_work"`, `"stiffness_work"` | [N, 1] float64 | work that the episode was supplied with, if measured |
    | `"net_actuation_work"`, `"net_stiffness_work"` | [N, 1] float64 | the same, less what came back |

    Args:
        task: A task or its id.
        bodies: A body or a list of n bodies: world w has body w % n. Or a stream, from which a world gets a new body
            at each reset: `draw(rng)` or an iterator, see `TaskEngine`.
        num_worlds: N; as many as bodies by default, 1 with a stream.
        device: Where tensors go; the simulator runs on the CPU.
        options: material, stiffness, edge_rule, physics, num_threads, grid_shape, work_weight and seed, as all
            environments take them: see `EngineOptions`.

    Raises:
        ValueError: For bad arguments, as `TaskEngine`; in a step for an action without these keys, of a wrong shape or
            with NaN.
    """

    _has_frame_skip = True  # 30 substeps an env-step are ours, not a transform's

    @lists_options
    def __init__(
        self,
        task: str | Task,
        bodies: BodySpec | Sequence[BodySpec] | BodySource,
        num_worlds: int | None = None,
        *,
        device: torch.device | str | None = None,
        **options: Unpack[EngineOptions],
    ) -> None:
        engine = TaskEngine(task, bodies, num_worlds, **options)
        super().__init__(device=device, batch_size=[engine.num_worlds])
        self.engine = engine
        self._renderer: Renderer | None = None
        self._make_specs()
        engine.set_seed(complete(options)["seed"])  # the first reset begins with it too

    def _make_specs(self) -> None:
        n, v = self.engine.occupancy.shape

        def flags(width: int) -> Categorical:
            return Categorical(2, shape=(n, width), dtype=torch.bool, device=self.device)

        def numbers(*shape: int, dtype: torch.dtype = torch.float32) -> Unbounded:
            return Unbounded((n, *shape), dtype=dtype, device=self.device)

        observation = {
            "voxels": numbers(v, N_FEATURES),
            "types": Categorical(N_TYPES, shape=(n, v, N_SIDES), dtype=torch.uint8, device=self.device),
            "occupancy": flags(v),
            "actuators": flags(v),
            "task": numbers(self.engine.features.shape[1]),
            "com": numbers(2, dtype=torch.float64),
            "score": numbers(1, dtype=torch.float64),
            "return": numbers(1, dtype=torch.float64),
            "unstable": flags(1),
            "reached": flags(1),
            **{name: numbers(1, dtype=torch.float64) for name in self.engine.works},
        }
        flat = self.engine.flat
        if flat is not None:
            observation["observation"] = numbers(flat.shape[1], dtype=torch.float64)
        action = {head: Bounded(*RANGES[head], (n, v), device=self.device) for head in self._heads}
        self.observation_spec = Composite(observation, shape=[n])
        self.action_spec = Composite(action=Composite(action, shape=[n]), shape=[n])
        self.reward_spec = numbers(1)
        self.done_spec = Composite(done=flags(1), terminated=flags(1), truncated=flags(1), shape=[n])

    def _observations(self) -> dict[str, np.ndarray]:
        """Returns the observations in fresh memory."""
        engine = self.engine
        return engine.observations() | {
            "com": engine.com,
            "score": engine.score[:, None].copy(),
            "return": engine.returns[:, None].copy(),
            "unstable": engine.unstable[:, None].copy(),
            "reached": engine.reached[:, None].copy(),
            **{name: values[:, None] for name, values in engine.works.items()},
        }

    def _pack(self, values: dict[str, np.ndarray]) -> TensorDict:
        """Returns arrays as a TensorDict, without its checks of each entry, which take ten times as long.

        TorchRL's own environments do the same; `_step_proc_data` below has the same reason.
        """
        tensors = {key: torch.from_numpy(value) for key, value in values.items()}
        packed = TensorDict._new_unsafe(tensors, batch_size=self.batch_size)
        return packed if self.device is None else packed.to(self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        mask = None
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(self.engine.num_worlds).cpu().numpy()
        self.engine.reset(mask)
        return self._pack(self._observations())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        engine = self.engine
        given = check_action(tensordict.get("action", None), ("action",), self._heads, engine.occupancy.shape)
        actions = [values.detach().cpu().numpy() for values in given]
        chosen = tensordict.get("_step", None)  # TorchRL's flag of the worlds to advance
        mask = None if chosen is None else chosen.reshape(engine.num_worlds).cpu().numpy()
        engine.step(actions[0], actions[1] if len(actions) > 1 else None, mask)
        values = self._observations()
        values["reward"] = engine.reward[:, None].astype(np.float32)
        values["terminated"] = engine.terminated[:, None].copy()
        values["truncated"] = engine.truncated[:, None].copy()
        values["done"] = values["terminated"] | values["truncated"]
        return self._pack(values)

    def _step_proc_data(self, next_tensordict_out: TensorDictBase) -> TensorDictBase:
        """Returns a step's result as it is: `_step` leaves TorchRL nothing to complete or to reshape."""
        if self.run_type_checks:
            return super()._step_proc_data(next_tensordict_out)
        return next_tensordict_out

    def render(self, width: int = 640, height: int = 320, view: str = "types") -> torch.Tensor:
        """Returns pictures of all worlds, uint8 [N, height, width, 3], see `Renderer`.

        Videos: `Compose(PixelRenderTransform(width=160, height=80), VideoRecorder(logger, tag))`.
        """
        renderer = self._renderer_of(width, height, view)
        pictures = np.stack([renderer.frame(world) for world in range(self.engine.num_worlds)])
        return torch.from_numpy(pictures).to(self.device)

    def _renderer_of(self, width: int, height: int, view: str) -> Renderer:
        """Returns what draws such pictures, the same one as long as no others are asked for: its cameras follow."""
        renderer = self._renderer
        if renderer is None or (renderer.width, renderer.height, renderer.view) != (width, height, view):
            renderer = self._renderer = Renderer(self.engine, width, height, view)
        return renderer

    def _set_seed(self, seed: int | None) -> None:
        self.engine.set_seed(seed)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Ends the simulator's threads; a later step starts them again."""
        self.engine.close()
        super().close(raise_if_closed=raise_if_closed)

    def get_extra_state(self) -> dict[str, Any]:
        """Returns everything that a step can change, as tensors, for `set_extra_state`.

        Raises:
            ValueError: Bodies come from an iterator, whose position cannot be saved.
        """
        return to_tensors(self.engine.state())

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restores a state of an environment made with the same arguments: a rollout continues exactly."""
        self.engine.set_state(to_arrays(state))


def check_action(action: Any, key: tuple[str, ...], heads: Sequence[str], shape: tuple[int, ...]) -> list[torch.Tensor]:
    """Returns the tensors of an action, by their names.

    Args:
        action: What is under `key`.
        key: Where actions are in the environment's TensorDict.
        heads: Names of the action's tensors.
        shape: Of each of them.

    Raises:
        ValueError: It is no TensorDict of these tensors, or a tensor has another shape.
    """
    values = [action.get(head, None) for head in heads] if isinstance(action, TensorDictBase) else []
    if len(values) != len(heads) or not all(isinstance(v, torch.Tensor) and v.shape == shape for v in values):
        got = brief(action)
        if isinstance(action, torch.Tensor):
            got = f"a tensor {list(action.shape)}"
        elif isinstance(action, TensorDictBase):
            got = some(f"{name!r} {list(getattr(value, 'shape', ()))}" for name, value in action.items()) or "nothing"
        made_of = " and ".join(f"{(*key, head)} {list(shape)}" for head in heads)
        raise ValueError(f"{key[-1]}: got {got}, expected {made_of}")
    return values


def to_tensors(value: Any) -> Any:
    """Returns a tree of dicts and lists with its arrays as tensors, which torch saves and loads without pickle."""
    if isinstance(value, dict):
        return {key: to_tensors(item) for key, item in value.items()}
    if isinstance(value, list):
        return [to_tensors(item) for item in value]
    return torch.from_numpy(value) if isinstance(value, np.ndarray) else value


def to_arrays(value: Any) -> Any:
    """Returns a tree of dicts and lists with its tensors as arrays."""
    if isinstance(value, dict):
        return {key: to_arrays(item) for key, item in value.items()}
    if isinstance(value, list):
        return [to_arrays(item) for item in value]
    return value.cpu().numpy() if isinstance(value, torch.Tensor) else value
