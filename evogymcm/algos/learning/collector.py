"""The collector of a training run, which can be stopped within episodes and go on there."""

import inspect
from typing import Any

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from evogymcm.algos.learning.devices import on_cpu

# What TorchRL's collectors do beside collecting and nothing here needs. Versions 0.11 and 0.12 know neither name: they
# add no transforms, and always number trajectories.
_WITHOUT: dict[str, Any] = {
    name: False
    for name in ("auto_register_policy_transforms", "track_traj_ids")
    if name in inspect.signature(Collector).parameters
}


class WorldCollector(Collector):
    """A collector whose state holds the live worlds too, so that a resumed run goes on within its episodes.

    The environment's own state must come with its `state_dict` (`get_extra_state`); without, resuming restarts the
    episodes.

    Args:
        env: The environment.
        policy: What acts in it.
        frames_per_batch: Env-steps of a rollout, in all worlds together.
    """

    _carrier: TensorDictBase

    def __init__(self, env: EnvBase, policy: TensorDictModuleBase, frames_per_batch: int) -> None:
        super().__init__(env, policy, frames_per_batch=frames_per_batch, **_WITHOUT)

    def state_dict(self) -> dict[str, Any]:
        """Returns the environment's state and the policy's next input, on the CPU."""
        carrier = self._carrier.exclude("collector")  # trajectories' numbers, which not every version of TorchRL has
        return {"env": dict(self.env.state_dict()), "carrier": on_cpu(carrier.to_dict())}

    def load_state_dict(self, state_dict: dict[str, Any], **kwargs: Any) -> None:
        """Restores what `state_dict` returned."""
        if not state_dict["env"]:
            return
        self.env.load_state_dict(state_dict["env"])
        carrier = self._carrier  # which TorchRL may give no device, though its tensors are on one
        self._carrier = TensorDict(state_dict["carrier"], batch_size=carrier.batch_size, device=self.env.device)
        if carrier.device is None:
            self._carrier.clear_device_()
        self._carrier.update(carrier.select("collector", strict=False))
