"""Settings of runs of earlier versions, in the words of today."""

from collections.abc import Mapping
from typing import Any

from evogymcm._settings import check_choice

_ARMS = ("reactive", "fixed", "invariant", "prescribed")


def of_arm(arm: str, prescribed: Any, search: Any) -> dict[str, Any]:
    """Returns what co-design calls an arm of before: material, stiffness, and search of stiffness fields or None."""
    check_choice("arm", arm, _ARMS)
    return {
        "material": "reactive" if arm == "reactive" else "invariant",
        "stiffness": prescribed if arm == "prescribed" else 1.0,
        "search": search if arm == "invariant" else None,
    }


def present_settings(config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns the saved settings of a run as a run of today has them."""
    config = _with_starts(config)
    is_training = isinstance(config.get("bodies"), list) and config.keys() & {"ppo", "total_steps"}
    if "budget" in config or is_training:
        config = {"initial": "fresh", **({} if "budget" in config else {"pool": None}), **config}
    if not {"arm", "prescribed", "search"} <= config.keys():
        return config
    rest = {name: value for name, value in config.items() if name not in ("arm", "prescribed")}
    return rest | of_arm(config["arm"], config["prescribed"], config["search"])


def _with_starts(config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns settings of PPO or co-design, or those that hold some, as earlier versions had them: with one start,
    a generation in one piece, and advantages scaled all alike.
    """  # noqa: D205
    inner = {name: _with_starts(config[name]) for name in ("ppo",) if isinstance(config.get(name), Mapping)}
    has_starts = config.keys() & {"eval_interval", "budget"}
    former: dict[str, Any] = {"eval_starts": 1, "selection": "score"} if has_starts else {}
    former |= {"piece": None} if "budget" in config else {}
    former |= {"advantage_scale": "batch"} if "eval_interval" in config else {}
    return former | dict(config) | inner
