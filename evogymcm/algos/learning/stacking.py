"""One set of weights for every design: stacked networks that train side by side, and moving weights between them.

Worlds are dealt to designs in turn (world w holds design w % D), as `SoftRobotEnv` does. Stacked networks (made with
`copies=D`) take inputs with a leading dimension of designs.
"""

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

State = dict[str, Tensor]


def by_design(data: Tensor | TensorDictBase, copies: int) -> Tensor | TensorDictBase:
    """Returns rows of worlds (N, ...) as rows of each design (D, N / D, ...)."""
    return data.reshape(-1, copies, *data.shape[1:]).transpose(0, 1)


def by_world(data: Tensor) -> Tensor:
    """Returns rows of each design (D, N / D, ...) as rows of worlds (N, ...): undoes `by_design`."""
    return data.transpose(0, 1).flatten(0, 1)


class PerDesign(TensorDictModuleBase):
    """Lets stacked networks act in an environment, whose batch is worlds.

    Args:
        network: the stacked module.
        copies: D, the number of designs.
    """

    def __init__(self, network: TensorDictModuleBase, copies: int) -> None:
        super().__init__()
        self.network, self.copies = network, copies
        self.in_keys, self.out_keys = network.in_keys, network.out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes what the network writes into `tensordict` (N,) and returns it."""
        inputs = {key: by_design(tensordict.get(key), self.copies) for key in self.in_keys}
        shape = (self.copies, tensordict.batch_size[0] // self.copies)
        out = self.network(TensorDict(inputs, batch_size=shape))
        for key in self.out_keys:
            tensordict.set(key, by_world(out.get(key)))
        return tensordict


def stack_states(states: Sequence[Mapping[str, Tensor]]) -> State:
    """Returns the weights of single networks as those of a stacked one."""
    return {key: torch.stack([state[key] for state in states]) for key in states[0]}


def take_state(state: Mapping[str, Tensor], index: int) -> State:
    """Returns one design's weights from those of a stacked network."""
    return {key: values[index].clone() for key, values in state.items()}
