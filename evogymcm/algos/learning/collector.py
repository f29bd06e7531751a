"""TorchRL's collector, with live worlds in its state."""

from typing import Any

from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector


class WorldCollector(Collector):
    """A collector whose state holds the live worlds too, so that a resumed run goes on within its episodes.

    The environment's own state must come with its `state_dict` (`get_extra_state`); without, resuming restarts the
    episodes.
    """

    _carrier: TensorDictBase

    def state_dict(self) -> dict[str, Any]:
        """Returns the environment's state and the policy's next input."""
        return {"env": dict(self.env.state_dict()), "carrier": self._carrier.to_dict()}

    def load_state_dict(self, state_dict: dict[str, Any], **kwargs: Any) -> None:
        """Restores what `state_dict` returned."""
        if not state_dict["env"]:
            return
        self.env.load_state_dict(state_dict["env"])
        self._carrier = TensorDict(state_dict["carrier"], batch_size=self._carrier.batch_size)
