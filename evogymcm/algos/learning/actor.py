"""Policies: one that drives every voxel of every body with the same small network, and a plain one to compare with."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import EnvBase

from evogymcm.algos.learning.context import make_context
from evogymcm.algos.learning.distributions import IDLE, MaskedClippedNormal, VoxelActions
from evogymcm.algos.learning.layers import N_INPUTS, Dense, NormalizedDense, compact, voxel_frame, voxel_inputs
from evogymcm.algos.learning.stacking import take_state
from evogymcm.algos.learning.threads import explores

# Action entry -> observation that marks the voxels it drives, and the mean action before training. Actuation starts
# in the middle of its range, stiffness at 1, where a co-optimised robot is the same robot as a control-only one.
_HEADS: Mapping[str, tuple[str, float | None]] = {"actuation": ("actuators", None), "stiffness": ("occupancy", IDLE)}
_REACH = 2.0  # means stay within this many half ranges: a bound can be held, and left again


class Actor(TensorDictModuleBase):
    """Stochastic policy with one bounded action for each voxel and head.

    It samples unless the exploration type is deterministic (`torchrl.envs.set_exploration_type`); trainers and
    evaluations set it for their own thread. With `copies`, it is D policies with weights of their own, and
    inputs have a leading dimension of designs (see `sharing`).

    Args:
        in_keys: observations that the means depend on.
        ranges: action entry ("actuation", "stiffness") -> (low, high).
        initial_std: standard deviation that training starts with, in half ranges of the action.
        copies: D, or None for a single policy.

    Raises:
        ValueError: if `ranges` names no head or an unknown one.
    """

    dist_sample_keys = ["action"]  # noqa: RUF012  (names that TorchRL's losses look up)
    log_prob_keys = ["action_log_prob"]  # noqa: RUF012
    noise_correlation: float  # of exploration, from one env-step to the next; 0 for white noise
    noise: Tensor | None  # the last step's
    generator: torch.Generator | None  # of the noise; None for torch's global one
    form: dict[str, Any]  # arguments that make another of the same form, with the name of the network

    def __init__(
        self, in_keys: list[str], ranges: Mapping[str, tuple[float, float]], initial_std: float, copies: int | None
    ) -> None:
        super().__init__()
        if not ranges or not set(ranges) <= set(_HEADS):
            raise ValueError(f"action heads: got {sorted(ranges)}, allowed are {sorted(_HEADS)}")
        self.ranges, self.copies = dict(ranges), copies
        self.in_keys = list(dict.fromkeys([*in_keys, *(_HEADS[name][0] for name in ranges)]))
        self.out_keys = [*(("action", name) for name in ranges), "action_log_prob"]
        self.noise_correlation, self.noise, self.generator = 0.0, None, None
        lead = () if copies is None else (copies,)
        self.log_std = nn.Parameter(torch.full((*lead, len(ranges)), math.log(initial_std)))

    def _starts(self) -> Tensor:
        """Outputs that give the heads' first actions."""
        starts = []
        for name, (low, high) in self.ranges.items():
            first = _HEADS[name][1]
            scaled = 0.0 if first is None else (2 * first - low - high) / (high - low)
            starts.append(_REACH * math.atanh(scaled / _REACH))
        return torch.tensor(starts)

    def outputs(self, tensordict: TensorDictBase) -> Tensor:
        """Returns the network's outputs, (..., V, heads)."""
        raise NotImplementedError

    def get_dist(self, tensordict: TensorDictBase) -> VoxelActions:
        """Returns the action distribution for the observations in `tensordict`."""
        means = _REACH * torch.tanh(self.outputs(tensordict) / _REACH)
        std = self.log_std.exp()
        if self.copies is not None:
            std = std.reshape(self.copies, *[1] * (means.dim() - 2), -1)
        return VoxelActions(
            {
                name: MaskedClippedNormal(
                    means[..., i], std[..., i], tensordict.get(_HEADS[name][0]), *self.ranges[name]
                )
                for i, name in enumerate(self.ranges)
            }
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` and `action_log_prob` into `tensordict` and returns it."""
        dist = self.get_dist(tensordict)
        action = dist.with_noise(self._draw(dist)) if explores() else dist.mode
        tensordict.set("action", action)
        tensordict.set("action_log_prob", dist.log_prob(action))
        return tensordict

    def _draw(self, dist: VoxelActions) -> Tensor:
        """Returns standard normal noise (..., V, heads), correlated with that of the step before."""
        loc = next(iter(dist.heads.values())).loc
        shape = (*loc.shape, len(self.ranges))
        place = loc.device if self.generator is None else self.generator.device
        fresh = torch.randn(shape, generator=self.generator, dtype=loc.dtype, device=place).to(loc.device)
        if not self.noise_correlation:
            return fresh
        if self.noise is None or self.noise.shape != fresh.shape:
            self.noise = fresh
        else:
            kept = self.noise_correlation
            self.noise = kept * self.noise + math.sqrt(1 - kept**2) * fresh
        return self.noise

    @torch.no_grad()
    def limit_std(self, limit: float) -> None:
        """Lowers standard deviations that are above `limit` to it."""
        self.log_std.clamp_(max=math.log(limit))

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        raise NotImplementedError

    def prepare(self, samples: TensorDictBase) -> TensorDictBase:
        """Returns `samples` with what the networks' passes over them have in common done once."""
        return samples


class VoxelActor(Actor):
    """Policy with weights shared by all voxels.

    Each voxel sees its own features, a context of the rest of its body, and the task's features. The module therefore
    takes any number of bodies, of any shape, in any padded grid.

    Args:
        task_features: features of the task, G.
        ranges: action entry ("actuation", "stiffness") -> (low, high).
        hidden: width of both hidden layers.
        initial_std: standard deviation that training starts with, in half ranges of the action.
        context: what a voxel knows about the rest of its body: "none", "body" (the mean over it), "message" (also what
            its neighbours encode) or "attention".
        columns: columns of the padded grid, needed for messages only; it is not a weight, and can be set again for
            another grid.
        copies: D policies with weights of their own; None for one.
        generator: random generator for the first weights; torch's global one by default.

    Raises:
        ValueError: if `ranges` names no head or an unknown one, and for an unknown context.
    """

    def __init__(
        self,
        task_features: int,
        ranges: Mapping[str, tuple[float, float]],
        hidden: int = 32,
        initial_std: float = 1.0,
        context: str = "body",
        columns: int = 1,
        copies: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(["voxels", "types", "task", "occupancy"], ranges, initial_std, copies)
        self.columns = columns
        self.form = {"network": "voxel", "task_features": task_features, "ranges": self.ranges, "hidden": hidden}
        self.form |= {"context": context, "columns": columns, "copies": copies}
        options: dict[str, Any] = {"copies": copies, "generator": generator}
        self.encode = NormalizedDense(N_INPUTS, hidden, voxel_frame(), **options)
        self.task = NormalizedDense(task_features, hidden, **options)
        self.local = Dense(hidden, hidden, bias=False, **options)  # that of the task's features is the layer's
        self.context = make_context(context, hidden, **options)
        self.heads = Dense(hidden, len(ranges), **options)
        for layer in (self.encode, self.local):
            layer.orthogonal(math.sqrt(2), generator)
        self.heads.orthogonal(0.01, generator)
        with torch.no_grad():
            self.heads.bias.copy_(self._starts())

    def outputs(self, tensordict: TensorDictBase) -> Tensor:
        """Returns the network's outputs, (..., V, heads)."""
        encoded = torch.relu(self.encode(voxel_inputs(tensordict)))
        occupancy, types, task = (tensordict.get(key) for key in ("occupancy", "types", "task"))
        context = self.context(encoded, occupancy, types, self.columns) + self.task(task).unsqueeze(-2)
        return self.heads(torch.relu(self.local(encoded) + context))

    def prepare(self, samples: TensorDictBase) -> TensorDictBase:
        """Returns `samples` without empty cells, as far as the context allows, and with `voxel_inputs`."""
        if not self.context.needs_grid:
            samples = compact(samples)
        return samples.set("voxel_inputs", voxel_inputs(samples)).exclude("voxels")

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(voxel_inputs(tensordict), tensordict.get("occupancy"))
        self.task.observe(tensordict.get("task"))


class MLPActor(Actor):
    """The plain policy of the paper, for one body: two layers of tanh units on the task's flat observation.

    Args:
        features: size of the flat observation, D.
        n_cells: cells of the body's grid, V.
        ranges: action entry ("actuation", "stiffness") -> (low, high).
        hidden: width of both hidden layers.
        initial_std: standard deviation that training starts with, in half ranges of the action.
        copies: policies with weights of their own; None for one.
        generator: random generator for the first weights; torch's global one by default.
    """

    def __init__(
        self,
        features: int,
        n_cells: int,
        ranges: Mapping[str, tuple[float, float]],
        hidden: int = 64,
        initial_std: float = 1.0,
        copies: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(["observation"], ranges, initial_std, copies)
        self.form = {"network": "mlp", "features": features, "n_cells": n_cells, "ranges": self.ranges}
        self.form |= {"hidden": hidden, "copies": copies}
        options: dict[str, Any] = {"copies": copies, "generator": generator}
        self.encode = NormalizedDense(features, hidden, **options)
        self.hidden = Dense(hidden, hidden, **options)
        self.heads = Dense(hidden, n_cells * len(ranges), **options)
        for layer in (self.encode, self.hidden):
            layer.orthogonal(math.sqrt(2), generator)
        self.heads.orthogonal(0.01, generator)
        with torch.no_grad():
            self.heads.bias.copy_(self._starts().repeat(n_cells))

    def outputs(self, tensordict: TensorDictBase) -> Tensor:
        """Returns the network's outputs, (..., V, heads)."""
        hidden = torch.tanh(self.encode(tensordict.get("observation").float()))
        return self.heads(torch.tanh(self.hidden(hidden))).unflatten(-1, (-1, len(self.ranges)))

    def observe(self, tensordict: TensorDictBase) -> None:
        """Takes observations (any batch shape) into the running normalisation of the inputs."""
        self.encode.observe(tensordict.get("observation").float())


def make_actor(
    env: EnvBase,
    hidden: int | None = None,
    initial_std: float = 1.0,
    *,
    network: str = "voxel",
    context: str = "body",
    copies: int | None = None,
    generator: torch.Generator | None = None,
) -> Actor:
    """Returns an untrained actor that fits the observations and action ranges of `env`.

    Args:
        env: a SoftRobotEnv.
        hidden: width of the hidden layers; None for the default of the network, 32 ("voxel") or 64 ("mlp").
        initial_std: standard deviation that training starts with, in half ranges of the action.
        network: "voxel", or "mlp" for the plain network on the flat observation, where all bodies are equal.
        context: context of the voxel network, see `VoxelActor`.
        copies: policies with weights of their own; None for one.
        generator: random generator for the first weights; torch's global one by default.

    Raises:
        ValueError: for an unknown network, and for "mlp" where bodies differ.
    """
    check_network(network, env)
    ranges, spec = ranges_of(env), env.observation_spec
    options: dict[str, Any] = {"initial_std": initial_std, "copies": copies, "generator": generator}
    options |= {} if hidden is None else {"hidden": hidden}
    if network == "mlp":
        return MLPActor(spec["observation"].shape[-1], spec["occupancy"].shape[-1], ranges, **options)
    return VoxelActor(spec["task"].shape[-1], ranges, context=context, columns=env.grid_shape[1], **options)


def ranges_of(env: EnvBase) -> dict[str, tuple[float, float]]:
    """Returns the action entries of a SoftRobotEnv -> (low, high)."""
    spaces = {name: spec.space for name, spec in env.full_action_spec["action"].items()}
    return {name: (space.low.min().item(), space.high.max().item()) for name, space in spaces.items()}


def load_actor(checkpoint: Mapping[str, Any], index: int | None = None) -> Actor:
    """Returns the actor of a policy that `train` has saved, in any grid.

    Args:
        checkpoint: what `RunFolder.load("final")` or `("best")` returns.
        index: the design whose policy is wanted, of independent ones; None for all of them, stacked.
    """
    form, weights = dict(checkpoint["form"]), checkpoint["actor"]
    if index is not None:
        form, weights = form | {"copies": None}, take_state(weights, index)
    network = {"voxel": VoxelActor, "mlp": MLPActor}[form.pop("network")]
    actor = network(**form, generator=torch.Generator())  # of weights that are replaced at once
    actor.load_state_dict(weights)
    return actor


def check_network(network: str, env: EnvBase) -> None:
    """Raises ValueError for an unknown network, and for "mlp" where there is no flat observation."""
    if network not in ("voxel", "mlp"):
        raise ValueError(f"network: got {network!r}, allowed are 'voxel' and 'mlp'")
    if network == "mlp" and "observation" not in env.observation_spec.keys():
        raise ValueError("network: 'mlp' takes the flat observation, which there is only where all bodies are equal")
