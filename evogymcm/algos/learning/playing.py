"""Playing episodes with a policy: the one loop that evaluation, recording and pictures share."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evogymcm._settings import WORK
from evogymcm.envs.core import TaskEngine
from evogymcm.envs.engines import engine_of

if TYPE_CHECKING:  # gaits are played without torch
    from tensordict.nn import TensorDictModuleBase

Gait = Callable[[TaskEngine], tuple[np.ndarray, np.ndarray | None]]
_RECORDS = ("score", "returns", "unstable", "goal", "work")


class Episodes:
    """The first episode of every world, as far as it has been played; arrays are (N,).

    Attributes:
        step: env-steps since the reset.
        running: which worlds are still in their episode.
        length: env-steps of the episode. The simulator has advanced each world by exactly so many.
        score: sum of the rewards without the last.
        returns: sum of all rewards.
        goal: whether the episode ended at a goal of the task.
        unstable: whether the simulation became unstable.
        ceiling: largest possible score, NaN where there is none.
        work: (N, 4) work of the episode, see `TaskEngine`; NaN where it is not measured.
    """

    def __init__(self, ceiling: NDArray[np.float64]) -> None:
        n = len(ceiling)
        self.step, self.ceiling, self.running = 0, ceiling, np.ones(n, bool)
        self.length, self.score, self.returns = np.zeros(n, np.int64), np.zeros(n), np.zeros(n)
        self.goal, self.unstable = np.zeros(n, bool), np.zeros(n, bool)
        self.work = np.full((n, len(WORK)), np.nan)

    def _take(self, outcome: "_Outcome") -> None:
        """Takes what came of an env-step, for the worlds that are running."""
        *records, done = outcome
        self.step += 1
        self.length += self.running
        for name, values in zip(_RECORDS, records, strict=True):
            getattr(self, name)[self.running] = values[self.running]
        self.running = self.running & ~done


_Outcome = tuple[np.ndarray, ...]  # the records, then which worlds are done


class _Stage(Protocol):
    """Worlds together with what acts in them."""

    def reset(self) -> NDArray[np.float64]:
        """Starts new episodes and returns the ceilings of their scores."""

    def step(self, running: NDArray[np.bool_]) -> _Outcome:
        """Advances the running worlds, and no others, by an env-step."""


class _OnEngine:
    """An engine that is stepped by a function of it."""

    def __init__(self, gait: Gait, engine: TaskEngine) -> None:
        self._gait, self._engine = gait, engine

    def reset(self) -> NDArray[np.float64]:
        self._engine.reset()
        return self._engine.score_ceiling.copy()

    def step(self, running: NDArray[np.bool_]) -> _Outcome:
        engine = self._engine
        engine.step(*self._gait(engine), mask=None if running.all() else running)
        work = np.full((len(running), len(WORK)), np.nan) if engine.work is None else engine.work
        ended = engine.terminated | engine.truncated
        return engine.score, engine.returns, engine.unstable, engine.reached, work, ended


class _InEnvironment:
    """A TorchRL environment in which a module acts."""

    def __init__(self, policy: "TensorDictModuleBase", env: Any) -> None:
        self._policy, self._env = policy, env

    def reset(self) -> NDArray[np.float64]:
        self._state = self._env.reset()
        return np.array(self._env.score_ceiling, dtype=np.float64)

    def step(self, running: NDArray[np.bool_]) -> _Outcome:
        import torch

        env = self._env
        with _deterministic():
            acted = self._policy(self._state)
            if not running.all():
                acted.set("_step", torch.from_numpy(running).reshape(env.batch_size))
            stepped = env.step(acted)
        self._state = env.step_mdp(stepped)
        told = stepped["next"]

        def of(key: str) -> np.ndarray:
            return told[key].reshape(len(running)).cpu().numpy()

        nothing = np.full(len(running), np.nan)
        work = np.stack([of(key) if key in told.keys() else nothing for key in WORK], axis=1)
        return of("score"), of("return"), of("unstable"), of("reached"), work, of("done")


def play(policy: "TensorDictModuleBase | Gait", env: object, *, steps: int | None = None) -> Iterator[Episodes]:
    """Plays one episode in every world with deterministic actions, and yields its state after every env-step.

    The worlds are reset first, and their start is yielded too. Worlds whose episode has ended wait for the others: they
    are neither simulated nor counted, and keep their last state. It always yields the same object.

        for now in play(policy, env):
            if now.step % 4 == 0:
                pictures.append(renderer.frame())
        print(now.score)

    The policy is not changed, and no random numbers are drawn from torch. A reset restores the initial state, but the
    random generators of the worlds continue where they were. Modules other than this library's actors follow TorchRL's
    exploration type, which all threads share: use them in one thread at a time.

    Args:
        policy: An actor, or any TensorDict module that writes the action of `SoftRobotEnv`; or a function of the engine
            that returns what `TaskEngine.step` takes, such as `sine_gait`.
        env: An environment of this library or its engine, which is reset and stepped (reset a Gymnasium or PettingZoo
            environment before you use it again). Episodes have the task's length, whatever the limit of a wrapper.
            Modules also take other TorchRL environments with the keys of `SoftRobotEnv`. They should respect TorchRL's
            `"_step"`; otherwise worlds run on after their end, which has no effect on the result.
        steps: Env-steps at most; by default to the end of all episodes.

    Raises:
        ValueError: `steps` is below 1, or the policy or environment is of another kind.
    """
    if steps is not None and steps < 1:
        raise ValueError(f"steps: got {steps}, at least 1 is needed")
    if not callable(policy):
        raise ValueError(
            f"policy: got {type(policy).__name__}, expected a TensorDict module or a function of an engine"
        )
    return _played(_stage(policy, env), steps)


def _played(stage: _Stage, steps: int | None) -> Iterator[Episodes]:
    episodes = Episodes(stage.reset())
    yield episodes
    while episodes.running.any() and episodes.step != steps:
        episodes._take(stage.step(episodes.running))
        yield episodes


def _stage(policy: Any, env: object) -> _Stage:
    """Returns worlds and policy together."""
    if not hasattr(policy, "in_keys"):
        return _OnEngine(policy, engine_of(env))
    from torchrl.envs import EnvBase

    if isinstance(env, EnvBase) and "done" in env.done_keys:  # in a population it is the group's
        return _InEnvironment(policy, env)
    engine = engine_of(env)
    engine.with_voxels = engine.with_voxels or "voxels" in policy.in_keys  # Gymnasium's does not observe them
    return _OnEngine(as_gait(policy), engine)


def as_gait(policy: "TensorDictModuleBase") -> Gait:
    """Returns a module as a function of an engine that observes what the module takes."""
    import torch
    from tensordict import TensorDict

    from evogymcm.envs.torchrl import check_action

    def act(engine: TaskEngine) -> tuple[np.ndarray, np.ndarray | None]:
        shown = engine.observations() | {"com": engine.com, "done": (engine.terminated | engine.truncated)[:, None]}
        seen = {key: torch.from_numpy(values) for key, values in shown.items()}
        with _deterministic():
            action = policy(TensorDict(seen, [engine.num_worlds])).get("action", None)
        heads = ("actuation", "stiffness") if engine.material == "reactive" else ("actuation",)
        given = [values.cpu().numpy() for values in check_action(action, ("action",), heads, engine.occupancy.shape)]
        return given[0], given[1] if len(given) > 1 else None

    return act


@contextmanager
def _deterministic() -> Iterator[None]:
    """Has policies act without noise in this thread, and torch record nothing."""
    import torch

    from evogymcm.algos.learning.threads import exploration

    with torch.no_grad(), exploration(False):
        yield
