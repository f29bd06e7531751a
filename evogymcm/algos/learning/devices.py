"""Where tensors are: networks may learn on a device of their own, and what is saved lies on the CPU."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor


def find_device(name: str) -> torch.device:
    """Returns the device of a name.

    Raises:
        ValueError: There is none on this machine.
    """
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ValueError(f"device: got {name!r}, which torch cannot use here: {str(error).splitlines()[0]}") from error
    return device


def on_cpu(state: Any) -> Any:
    """Returns a tree of mappings, lists and tuples with its tensors on the CPU; those that are there are not copied."""
    if isinstance(state, Tensor):
        return state.cpu()
    if isinstance(state, Mapping):
        return {key: on_cpu(value) for key, value in state.items()}
    if isinstance(state, list | tuple):
        return type(state)(map(on_cpu, state))
    return state
