"""The episodes of many worlds: what they draw, earn and remember, how they end, and how all that is saved."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evogymcm._settings import WORK
from evogymcm.envs import checks
from evogymcm.envs.states import checked_arrays, checked_rngs
from evogymcm.envs.task import Snapshot, Task

UNSTABLE_PENALTY = -3.0
_ONE = np.array(1)  # numpy takes arrays faster than Python's numbers
_ACCOUNTS = ("reward", "score", "returns", "length", "terminated", "truncated", "unstable", "reached")


class Episodes:
    """The present episode of each of N worlds.

    Args:
        task: The task.
        num_worlds: N.
        work_weight: What supplied work of actuation and of stiffness costs; None to measure none.

    Attributes:
        memory: What the task has drawn and remembers, arrays with N rows. For the others see `TaskEngine`.
    """

    def __init__(self, task: Task, num_worlds: int, work_weight: tuple[float, float] | None) -> None:
        n = num_worlds
        self._work_weight = work_weight
        self.work = None if work_weight is None else np.zeros((n, len(WORK)))
        self.task, self.num_worlds = task, n
        self.reward, self.score, self.returns, self.length = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, int)
        self.terminated, self.truncated, self.unstable, self.reached = (np.zeros(n, bool) for _ in range(4))
        self.memory: dict[str, np.ndarray] = {}
        self._rngs: list[np.random.Generator] = []
        self._time_limit = np.array(min(task.time_limit, np.iinfo(np.int64).max))

    def _seed(self, seeds: Sequence[int | None]) -> None:
        """Gives each world a new generator for its draws."""
        self._rngs = [np.random.default_rng(seed) for seed in seeds]

    def _draw(self, chosen: np.ndarray) -> None:
        """Draws what the episodes of the chosen worlds hold at random, each from its world's own generator."""
        if type(self.task).draw is Task.draw and not self.task.moves_at_reset:
            return  # nothing
        for world in np.flatnonzero(chosen):
            row = checks.checked_draw(self.task, self.task.draw(self._rngs[world]), self.memory)
            if not self.memory:
                self.memory = {name: np.zeros((self.num_worlds, *v.shape), v.dtype) for name, v in row.items()}
            for name, value in row.items():
                self.memory[name][world] = value

    def _begin(self, chosen: np.ndarray) -> None:
        """Begins episodes in the worlds of the (N,) mask, where nothing has been earned."""
        for name in _ACCOUNTS:
            getattr(self, name)[chosen] = 0
        if self.work is not None:
            self.work[chosen] = 0

    @property
    def works(self) -> dict[str, np.ndarray]:
        """(N,) work of the episode (fresh memory), by the names in infos; nothing where it is not measured."""
        return {} if self.work is None else dict(zip(WORK, self.work.T.copy(), strict=True))

    def _charge(self, work: np.ndarray) -> None:
        """Takes up the (N, 4) work of a step, and what it costs."""
        assert self.work is not None
        assert self._work_weight is not None
        self.work = self.work + work
        by_actuation, by_stiffness = self._work_weight
        if by_actuation or by_stiffness:
            self.reward = self.reward - (by_actuation * work[:, 0] + by_stiffness * work[:, 1])

    def _settle(self, before: Snapshot, now: Snapshot, unstable: np.ndarray, mask: np.ndarray | None) -> None:
        """Takes up the rewards and endings of a step, for the worlds of the (N,) mask; all by default.

        Args:
            before: Readings before the step.
            now: Readings after it.
            unstable: (N,) bool, worlds that became unstable in it.
            mask: The worlds that have made it.
        """
        n = self.num_worlds
        reward = checks.checked_reward(self.task.reward(before, now), n)
        terminated, reached = unstable.copy(), np.zeros(n, bool)
        broke_down = np.count_nonzero(unstable)  # `any` takes four times as long for one world
        if broke_down:
            reward += np.where(unstable, UNSTABLE_PENALTY, 0.0)
        for condition, bonus, is_goal in checks.checked_endings(self.task, now):
            if np.count_nonzero(condition):
                reward += np.where(condition, bonus, 0.0)
                terminated |= condition
                reached |= condition & is_goal
        if broke_down:
            reached &= ~unstable  # an unstable step goes nowhere
        if self.memory:
            self._remember(now, mask)
        length, score, returns = self.length + _ONE, self.returns, self.returns + reward
        truncated = length >= self._time_limit
        if mask is not None:
            self.reward = np.zeros(n)  # of those that have made no step
            new = reward, score, returns, length, terminated, truncated, unstable, reached
            old = (getattr(self, name) for name in _ACCOUNTS)
            new = tuple(np.where(mask, *pair) for pair in zip(new, old, strict=True))
            reward, score, returns, length, terminated, truncated, unstable, reached = new
        self.reward, self.score, self.returns, self.length = reward, score, returns, length
        self.terminated, self.truncated, self.unstable, self.reached = terminated, truncated, unstable, reached

    def _remember(self, now: Snapshot, mask: np.ndarray | None) -> None:
        """Takes up the task's memory for the next step, for the worlds of the mask."""
        for name, values in checks.checked_memory(self.task.remember(now), self.memory).items():
            rows = True if mask is None else mask.reshape(-1, *([1] * (values.ndim - 1)))
            self.memory[name] = np.where(rows, values, self.memory[name])

    def _saved(self) -> dict[str, Any]:
        """Returns a copy of all this, for `_checked` and `_take_up`."""
        return {name: getattr(self, name).copy() for name in _ACCOUNTS} | {
            "memory": {name: values.copy() for name, values in self.memory.items()},
            "rngs": [rng.bit_generator.state for rng in self._rngs] if self.memory else [],
            **({} if self.work is None else {"work": self.work.copy()}),
        }

    def _checked(self, state: Mapping[str, Any]) -> dict[str, Any]:
        """Returns what `_take_up` takes, of what `_saved` returned; ValueError where it is of other worlds."""
        reached = {"reached": np.zeros(self.num_worlds, bool)}  # which states of older releases lack
        names = _ACCOUNTS if self.work is None else (*_ACCOUNTS, "work")
        checked: dict[str, Any] = checked_arrays(reached | dict(state), {name: getattr(self, name) for name in names})
        checked["memory"] = checked_arrays(state, self.memory, "memory")
        checked["_rngs"] = checked_rngs(state, self._rngs if self.memory else []) or self._rngs
        return checked

    def _take_up(self, checked: Mapping[str, Any]) -> None:
        """Sets attributes."""
        for name, value in checked.items():
            setattr(self, name, value)
