"""Universal policies that come with the package: each was trained on random bodies of one task, and moves any body.

Of each there are two files in the folder beside this module: weights (.npz, without pickle) and the record (.json).
"""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from evogymcm._messages import brief
from evogymcm._settings import Material, check_choice

if TYPE_CHECKING:  # which ones there are is known without torch
    from evogymcm.algos.learning.actor import Actor
    from evogymcm.algos.runs.policies import SavedPolicy

FOLDER = Path(__file__).with_suffix("")
_NAME = re.compile(rf"(.+)-({'|'.join(get_args(Material))})")
_PARTS = ("actor", "critic")


def baseline(task: str, material: Material = "invariant") -> "Actor":
    """Returns the package's universal policy for a task: a trained actor that moves any body.

    It is a TensorDict module for `SoftRobotEnv`, `play`, `evaluate` and TorchRL's collectors. It explores as at the end
    of its training unless the exploration type is deterministic. To train it further, see `TrainConfig.initial`.

    Args:
        task: Id of the task.
        material: Whether it sets stiffness too ("reactive"), or stiffness belongs to the body ("invariant").

    Raises:
        ValueError: There is none for this task in this setting.
    """
    from evogymcm.algos.learning.actor import load_actor

    return load_actor(load_baseline(task, material).state)


def baselines() -> dict[tuple[str, str], dict[str, Any]]:
    """Returns the record of each policy that `baseline` knows, by (task, material).

    | key | what |
    | --- | --- |
    | `task`, `material`, `random_bodies`, `pool`, `stiffness`, `edge_rule` | the training, see `TrainConfig` |
    | `env_steps`, `seconds`, `seed`, `ppo` | how long, and with which settings |
    | `command` | what repeats the training |
    | `policy` | which policy of that run it is: "final" or "best" |
    | `score`, `robust_score`, `spread` | means over held-out bodies, see `Evaluation` |
    | `starts`, `robust_scores` | of each body, and the robust score of each |
    | `form`, `origin` | the networks; processor, versions and commit of the training |
    """
    matches = [match for path in sorted(FOLDER.glob("*.json")) if (match := _NAME.fullmatch(path.stem))]
    return {(match[1], match[2]): _record(match[1], match[2]) for match in matches}


def has_baseline(task: str, material: str) -> bool:
    """Whether there is one for a task in a setting."""
    return isinstance(task, str) and any(path.stem == f"{task}-{material}" for path in FOLDER.glob("*.json"))


def load_baseline(task: str, material: str) -> "SavedPolicy":
    """Returns a policy with its critic; ValueError as `baseline`."""
    check_choice("material", material, get_args(Material))
    if not has_baseline(task, material):
        there = ", ".join(f"{name} ({setting})" for name, setting in baselines()) or "none at all"
        raise ValueError(f"baseline: got {brief(task)} ({material}), the package has {there}")
    import numpy as np
    import torch

    from evogymcm.algos.runs.policies import SavedPolicy

    record, path = _record(task, material), FOLDER / f"{task}-{material}.npz"
    form = record["form"]
    state: dict[str, Any] = {"form": form | {"ranges": {name: tuple(ends) for name, ends in form["ranges"].items()}}}
    with np.load(path, allow_pickle=False) as arrays:
        for part in _PARTS:
            names = [name for name in arrays.files if name.startswith(f"{part}/")]
            state[part] = {name.partition("/")[2]: torch.from_numpy(arrays[name]) for name in names}
    return SavedPolicy(path, state, material, task, (), None, record["edge_rule"])


def _record(task: str, material: str) -> dict[str, Any]:
    return dict(json.loads((FOLDER / f"{task}-{material}.json").read_text(encoding="utf-8")))
