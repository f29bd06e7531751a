"""The contract of learning environments, which `Trainer` trains policies in."""

import io
from collections.abc import Sequence
from operator import index
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from evogymcm._messages import brief
from evogymcm.algos.learning.env import EnvFactory
from evogymcm.testing._generators import global_generators

_PER_VOXEL, _PER_WORLD = ("occupancy", "actuators"), ("unstable", "reached")  # flags
_SUMS, _ENDS = ("score", "return"), ("done", "terminated", "truncated")
_HEADS = ("actuation", "stiffness")
_UNBOUNDED = 1e6  # TorchRL's specs without bounds have very large ones


def check_env(make_env: EnvFactory, *, num_worlds: int | None = None, steps: int = 8, seed: int = 0) -> None:
    """Raises an error for what an environment lacks to be trained in, or would learn wrong numbers from.

    It steps the environment with random actions, resets worlds as they end, and checks attributes, specs, and the
    shape and kind of all that a policy, an evaluation or the learner reads, see `TrainingEnv`; that worlds hold designs
    in turn; that `return` is the sum of an episode's rewards and `score` the same without the last, and both begin
    again with the next episode (sums are not compared where work is measured, which may have a price in rewards); that
    equal seeds give equal rollouts, and no draw comes from a global generator; and,
    where the environment saves its state, that another one goes on from it exactly, through a file.

    Args:
        make_env: Makes the environment, as for `Trainer`: `partial(MyEnv, bodies=bodies)`.
        num_worlds: Worlds; two of each design by default.
        steps: Env-steps. What is said of an episode's end is seen where one ends within them.
        seed: Seed of the environment and the actions.

    Raises:
        ValueError: The environment breaks the contract of `TrainingEnv`; the message says where.
    """
    if not callable(make_env) or isinstance(make_env, EnvBase):
        raise ValueError(f"make_env: got {brief(make_env)}, expected what makes environments, such as a partial")
    made: list[EnvBase] = []

    def make(worlds: int) -> EnvBase:
        made.append(make_env(num_worlds=worlds, seed=seed))
        return made[-1]

    try:
        env = make(num_worlds or 1)
        _check_attributes(env)
        if num_worlds is None:
            env = make(2 * env.num_designs)
        before = global_generators()
        check = _Checked(env)
        check.start(env.reset())
        twin, resumed = make(check.n), make(check.n)
        others = {"another environment with the same seed": (twin, twin.reset())}
        actions = _Actions(env, seed)
        shown = check.last
        for step in range(steps):
            if step == steps // 2 and dict(env.state_dict()):
                resumed.reset()
                resumed.load_state_dict(_through_file(env.state_dict()))
                others["an environment that goes on from a saved state"] = resumed, shown.clone()
            action = actions.draw()
            stepped, root = env.step_and_maybe_reset(shown.update({"action": action.clone()}))
            shown = check.step(stepped, root, step)
            for what, (other, root) in others.items():
                _, root = other.step_and_maybe_reset(root.update({"action": action.clone()}))
                check.compare(what, root, step)
                others[what] = other, root
        if before != global_generators():
            check.fail("draws", "it uses a global generator; draw from one of its own, made from `seed`")
    finally:
        for one in made:
            if isinstance(one, EnvBase):
                one.close(raise_if_closed=False)


def _check_attributes(env: Any) -> None:
    """Checks what is asked of an environment before it is reset."""
    if not isinstance(env, EnvBase):
        raise ValueError(f"make_env: it returned {brief(env)}, expected a TorchRL environment (EnvBase)")
    name = _name(env)
    for attribute in ("task", "num_designs", "grid_shape", "score_ceiling"):
        if not hasattr(env, attribute):
            raise ValueError(f"{name}: {attribute}: there is none; see TrainingEnv")
    if not _is_whole(env.num_designs):
        raise ValueError(f"{name}: num_designs: got {brief(env.num_designs)}, expected a whole number of at least 1")
    shape = env.grid_shape
    if not isinstance(shape, Sequence) or len(shape) != 2 or not all(map(_is_whole, shape)):
        raise ValueError(f"{name}: grid_shape: got {brief(shape)}, expected (rows, columns)")


def _is_whole(value: Any) -> bool:
    try:
        return index(value) >= 1
    except TypeError:
        return False


def _name(env: object) -> str:
    return f"environment {type(env).__name__}"


class _Actions:
    """Draws actions within their ranges."""

    def __init__(self, env: EnvBase, seed: int) -> None:
        self._specs = dict(env.full_action_spec["action"].items())
        self._generator = torch.Generator().manual_seed(seed)

    def draw(self) -> TensorDict:
        parts = {}
        for head, spec in self._specs.items():
            low, high = spec.space.low.cpu(), spec.space.high.cpu()
            chance = torch.rand(spec.shape, generator=self._generator)
            parts[head] = (low + chance * (high - low)).to(spec.device)
        (n, _), device = spec.shape, spec.device
        return TensorDict(parts, [n], device=device)


class _Checked:
    """One environment that is stepped, with what is known of its episodes."""

    last: TensorDictBase

    def __init__(self, env: EnvBase) -> None:
        self._env = env
        if len(env.batch_size) != 1:
            self.fail("batch_size", f"got {list(env.batch_size)}, expected [num_worlds]")
        (self.n,) = env.batch_size
        self._v = int(np.prod(env.grid_shape))
        self._check_specs()
        self._sum, self._before = torch.zeros(self.n, 1).double(), torch.zeros(self.n, 1).double()

    def fail(self, where: str, what: str) -> None:
        raise ValueError(f"{_name(self._env)}: {where}: {what}")

    def _check_specs(self) -> None:
        env = self._env
        action = env.full_action_spec
        heads = list(action["action"].keys()) if "action" in action.keys() and hasattr(action["action"], "keys") else []
        if "actuation" not in heads or not set(heads) <= set(_HEADS):
            allowed = "('action', 'actuation') and, where policies set stiffness, ('action', 'stiffness')"
            self.fail("action_spec", f"got {brief(list(action.keys(True, True)))}, expected {allowed}")
        for head in heads:
            spec = action["action", head]
            self._check_shape(f"action_spec: {head!r}", spec.shape, (self.n, self._v))
            nothing = torch.zeros(())
            low, high = (getattr(spec.space, name, nothing) for name in ("low", "high"))
            if not bool(((low < high) & (low.abs() < _UNBOUNDED) & (high.abs() < _UNBOUNDED)).all()):
                self.fail(f"action_spec: {head!r}", "expected a Bounded spec, whose low is below its high")
        known = set(env.observation_spec.keys())
        needed = {"task", *_PER_VOXEL, *_SUMS, *_PER_WORLD}
        if missing := sorted(needed - known):
            self.fail("observation_spec", f"it has no {', '.join(missing)}")
        if not {"voxels", "types"} <= known and "observation" not in known:
            self.fail("observation_spec", "expected 'voxels' and 'types' (network 'voxel') or 'observation' ('mlp')")

    def _check_shape(self, where: str, got: Sequence[int], expected: tuple[int | None, ...]) -> None:
        if len(got) != len(expected) or any(e is not None and e != g for g, e in zip(got, expected, strict=True)):
            wanted = ", ".join("any" if e is None else str(e) for e in expected)
            self.fail(where, f"got shape {list(got)}, expected [{wanted}] ({self.n} worlds, {self._v} cells)")

    def start(self, shown: TensorDictBase) -> None:
        """Checks what the first reset shows."""
        self._check_shown(shown, "reset")
        self.last = shown
        for name in _SUMS:
            if shown[name].any():
                self.fail(name, f"got {shown[name].tolist()} at reset, expected 0")
        designs = self._env.num_designs
        for name in _PER_VOXEL:
            for world in range(designs, self.n):
                if not torch.equal(shown[name][world], shown[name][world % designs]):
                    self.fail(name, f"world {world} differs from world {world % designs}; it holds body w % {designs}")
        if bool((shown["actuators"] & ~shown["occupancy"]).any()):
            self.fail("actuators", "some are in cells that hold no voxel (occupancy)")
        if not bool(shown["actuators"].any(-1).all()):
            self.fail("actuators", "a world has none")
        ceiling = np.asarray(self._env.score_ceiling)
        if ceiling.shape != (self.n,) or ceiling.dtype.kind != "f":
            got = f"{ceiling.dtype} of shape {ceiling.shape}"
            self.fail("score_ceiling", f"got {got}, expected floats of shape ({self.n},), NaN where there is none")

    def _check_shown(self, shown: TensorDictBase, where: str) -> None:
        """Checks the shapes and kinds of observations."""
        n, v = self.n, self._v
        shapes: dict[str, tuple[int | None, ...]] = {"task": (n, None), "observation": (n, None)}
        shapes |= {"voxels": (n, v, None), "types": (n, v, 5)}
        shapes |= dict.fromkeys(_PER_VOXEL, (n, v)) | dict.fromkeys((*_PER_WORLD, *_SUMS, *_ENDS), (n, 1))
        for name, spec in self._env.observation_spec.items():
            value = shown.get(name, None)
            if value is None:
                self.fail(where, f"it returns no {name!r}, which is in observation_spec")
            if value.shape != spec.shape or value.dtype != spec.dtype:
                got, expected = (f"{one.dtype} {list(one.shape)}" for one in (value, spec))
                self.fail(where, f"{name!r} is {got}, observation_spec says {expected}")
        for name in shapes.keys() & set(shown.keys()):
            value = shown[name]
            self._check_shape(f"{where}: {name!r}", value.shape, shapes[name])
            is_flag = name in _PER_VOXEL + _PER_WORLD + _ENDS
            if is_flag != (value.dtype == torch.bool):
                self.fail(where, f"{name!r} is {value.dtype}, expected {'bool' if is_flag else 'numbers'}")
            if not bool(value.isfinite().all()):
                self.fail(where, f"{name!r} is not finite")

    def step(self, stepped: TensorDictBase, root: TensorDictBase, number: int) -> TensorDictBase:
        """Checks a step and what comes next, where ended worlds have been reset; returns the latter."""
        after, where = stepped["next"], f"env-step {number + 1}"
        self._check_shown(after, where)
        for name in ("reward", *_ENDS):
            if after.get(name, None) is None:
                self.fail(where, f"it returns no {name!r}")
        self._check_shape(f"{where}: 'reward'", after["reward"].shape, (self.n, 1))
        reward, done = after["reward"].double(), after["done"]
        if not bool(reward.isfinite().all()):
            self.fail(where, f"'reward' is {reward.ravel().tolist()}, not finite")
        if not torch.equal(done, after["terminated"] | after["truncated"]):
            self.fail(where, "'done' is not 'terminated' or 'truncated'")
        self._before, self._sum = self._sum, self._sum + reward
        is_priced = "actuation_work" in after.keys()  # then work lowers rewards, and what is told is the task's
        if not is_priced:
            self._close(where, "return", after["return"], self._sum, "the sum of the episode's rewards")
        if bool(done.any()) and not is_priced:
            rows = done[:, 0]
            self._close(where, "score", after["score"][rows], self._before[rows], "that sum without the last reward")
        self._check_next(after, root, done[:, 0], where)
        self._sum[done] = 0.0
        self.last = root
        return root

    def _close(self, where: str, name: str, got: torch.Tensor, expected: torch.Tensor, what: str) -> None:
        if not torch.allclose(got.double(), expected, rtol=1e-4, atol=1e-5):
            self.fail(where, f"{name!r} is {got.ravel().tolist()}, expected {what}, {expected.ravel().tolist()}")

    def _check_next(self, after: TensorDictBase, root: TensorDictBase, done: torch.Tensor, where: str) -> None:
        """Checks that worlds which have ended begin again, and that the others go on."""
        self._check_shown(root, f"reset after {where}")
        for name in _SUMS:
            if bool(root[name][done].any()):
                self.fail(name, f"a world that was reset after {where} still has {root[name][done].ravel().tolist()}")
        for name in self._env.observation_spec.keys():
            if not torch.equal(root[name][~done], after[name][~done]):
                self.fail(name, f"worlds that have not ended in {where} are changed by the reset of others")

    def compare(self, what: str, root: TensorDictBase, number: int) -> None:
        """Checks that another environment shows the same."""
        for name in self._env.observation_spec.keys():
            if not torch.equal(root[name], self.last[name]):
                self.fail(name, f"{what} shows other values after env-step {number + 1}")


def _through_file(state: Any) -> Any:
    file = io.BytesIO()
    torch.save(dict(state), file)
    file.seek(0)
    return torch.load(file, weights_only=True)
