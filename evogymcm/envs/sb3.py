"""The batched simulator as a vector environment of Stable-Baselines3."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from evogymcm._settings import WORK
from evogymcm.envs.dealing import BodySpec
from evogymcm.envs.gymnasium import GymnasiumVectorEnv
from evogymcm.envs.task import Task

_missing: ImportError | None = None
try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:  # the module can be read without, as all others
    Monitor, VecEnv, _missing = None, object, error  # type: ignore[assignment, misc]


class SB3VecEnv(VecEnv):
    """Many worlds of one task, stepped together by one simulator in this process; bodies must be equal.

    A world that ends is reset at once. Its `info` then holds `terminal_observation`, and `episode` as from SB3's
    `Monitor`, so that no `VecMonitor` is needed. In every step `info` has the entries of `GymnasiumEnv`, and
    `TimeLimit.truncated`. Methods and attributes of a world (`env_method`, `get_attr`) are those of `GymnasiumEnv`.

    Args:
        task: A task or its id.
        body: One body or a list of `num_envs`.
        num_envs: Number of worlds.
        options: Other arguments of `GymnasiumVectorEnv`: material, stiffness, edge_rule, max_episode_steps,
            num_threads, render_mode and so on.

    Raises:
        ImportError: stable-baselines3 is not installed.
        ValueError: For bad arguments, as `GymnasiumVectorEnv`.
    """

    _actions: np.ndarray

    def __init__(
        self, task: str | Task, body: BodySpec | Sequence[BodySpec], num_envs: int = 1, **options: Any
    ) -> None:
        if _missing is not None:
            raise ImportError("SB3VecEnv needs stable-baselines3: pip install evogymcm[sb3]") from _missing
        if "autoreset_mode" in options:
            raise ValueError("autoreset_mode: Stable-Baselines3 has its own, in which ended worlds restart at once")
        self.envs = GymnasiumVectorEnv(task, body, num_envs, autoreset_mode="SameStep", **options)
        num_envs = self.envs.num_envs
        self._lengths = np.zeros(num_envs, np.int64)
        self._begin = time.time()
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> np.ndarray:
        """Starts episodes in all worlds, with the seeds last given to `seed`, and returns (N, D) observations."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        observations, info = self.envs.reset(seed=seeds)
        self._lengths[:] = 0
        self.reset_infos = self._rows(info)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the (N, A) actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Advances the worlds by one env-step.

        Returns:
            Observations, rewards (float32), dones and infos; of worlds that ended, the observation is that of the next
            episode, and the rest is that of the last step.
        """
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        dones = terminated | truncated
        self._lengths += 1
        infos = self._rows(info.get("final_info", info))
        for row, is_cut in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            row["TimeLimit.truncated"] = is_cut
        for i in np.flatnonzero(dones):
            infos[i]["terminal_observation"] = info["final_obs"][i]
            length, elapsed = int(self._lengths[i]), round(time.time() - self._begin, 6)
            infos[i]["episode"] = {"r": float(infos[i]["return"]), "l": length, "t": elapsed}
        if dones.any():
            starts = self._rows(info)
            self.reset_infos = [
                start if is_done else old
                for start, old, is_done in zip(starts, self.reset_infos, dones.tolist(), strict=True)
            ]
        self._lengths[dones] = 0
        return observations, rewards.astype(np.float32), dones, infos

    def _rows(self, info: dict[str, Any]) -> list[dict[str, Any]]:
        """Returns the info of each world."""
        names = [name for name in ("com", "unstable", "reached", "score", "return", *WORK) if name in info]
        rows = [dict(zip(names, values, strict=True)) for values in zip(*(info[name] for name in names), strict=True)]
        changed = self.envs.changed
        return [row | {"physics": dict(changed)} for row in rows] if changed else rows

    def close(self) -> None:
        """Frees the worlds' resources."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Returns a picture of each world, None where no `render_mode` was given."""
        return [world.render() for world in self.envs.worlds]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Returns an attribute of each world, or of those with these numbers."""
        return [getattr(self.envs.worlds[i], attr_name) for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of each world, or of those with these numbers."""
        for i in self._get_indices(indices):
            setattr(self.envs.worlds[i], attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Returns what a method of each world returns, or of those with these numbers."""
        return [method(*method_args, **method_kwargs) for method in self.get_attr(method_name, indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Returns whether each world has that wrapper: none has, except that `info` has the entries of a `Monitor`."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
