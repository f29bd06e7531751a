"""`check_env`: it finds each mistake in a learning environment of one's own, and none in those of the package."""

from functools import partial

import numpy as np
import pytest
import torch
from torchrl.data import Bounded, Categorical, Unbounded

import evogymcm as cm
from evogymcm.envs import SoftRobotEnv, population_env
from evogymcm.testing import check_env
from tests.algos.toy_env import SMALL, WIDE, ToyEnv, ToyTask
from tests.envs.lottery import LOTTERY
from tests.envs.tools import SMALL as BODY
from tests.envs.tools import WIDE as OTHER_BODY

SHORT = ToyTask(time_limit=3)


def draw(rng):
    return cm.sample_body((2, 3), rng)


@pytest.mark.parametrize("task", sorted(cm.tasks))
def test_tasks_of_the_package_can_be_learned(task):
    check_env(partial(SoftRobotEnv, task, [BODY], material="reactive", num_threads=1), steps=2)


@pytest.mark.parametrize("material", ["invariant", "reactive"])
@pytest.mark.parametrize("bodies", [[BODY], [BODY, OTHER_BODY], draw])
def test_bodies_of_all_kinds_can_be_learned_with(bodies, material):
    check_env(partial(SoftRobotEnv, LOTTERY, bodies, material=material, grid_shape=(3, 4), num_threads=1))


def test_an_environment_of_ones_own_has_no_mistakes():
    check_env(partial(ToyEnv, SHORT, bodies=[SMALL, WIDE], noise=0.1))
    check_env(partial(ToyEnv, SHORT, material="invariant"), num_worlds=3, steps=5)


class Toy(ToyEnv):
    """A toy that shows other observations; `change` sets them."""

    def change(self, shown):
        """Changes the observations."""

    def _observation(self):
        shown = super()._observation()
        self.change(shown)
        return shown


def showing(change):
    return type("Mine", (Toy,), {"change": lambda self, shown: change(self, shown)})


def of_spec(change):
    """A toy with another spec."""

    def make_specs(self, n, v):
        ToyEnv._make_specs(self, n, v)
        change(self, n, v)

    return type("Mine", (ToyEnv,), {"_make_specs": make_specs})


def stepping(change):
    """A toy whose steps return something else."""

    def step(self, tensordict):
        stepped = ToyEnv._step(self, tensordict)
        change(self, stepped)
        return stepped

    return type("Mine", (ToyEnv,), {"_step": step})


def having(**attributes):
    def init(self, *args, **options):
        ToyEnv.__init__(self, *args, **options)
        for name, value in attributes.items():
            setattr(self, name, value)

    return type("Mine", (ToyEnv,), {"__init__": init})


class WithoutDesigns(ToyEnv):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        del self.num_designs


class OtherBodies(ToyEnv):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.num_designs = 1


class KeepsReturns(ToyEnv):
    def _reset(self, tensordict=None, **kwargs):
        kept = self.ret.copy()
        super()._reset(tensordict)
        self.ret = kept
        from tensordict import TensorDict

        return TensorDict(self._observation(), batch_size=self.batch_size)


class ResetsAll(ToyEnv):
    def _reset(self, tensordict=None, **kwargs):
        return super()._reset(None)

    def step_and_maybe_reset(self, tensordict):
        stepped, root = super().step_and_maybe_reset(tensordict)
        if stepped["next", "done"].any():
            root = self.reset()
        return stepped, root


class Unseeded(ToyEnv):
    def _set_seed(self, seed):
        self.rng = np.random.default_rng()


class GlobalNoise(Toy):
    def change(self, shown):
        shown["task"] = shown["task"] + torch.rand(1)


class Amnesic(ToyEnv):
    def set_extra_state(self, state):
        super().set_extra_state({name: value for name, value in state.items() if name != "x"})


def drop(name):
    return lambda self, n, v: self.observation_spec.__delitem__(name)


def nan(self, shown):
    shown["task"][0, 0] = float("nan")


def scored(self, shown):
    shown["score"] = shown["return"].clone()


WRONG = {
    "num_designs": (WithoutDesigns, "num_designs: there is none"),
    "designs of 0": (having(num_designs=0), "num_designs: got 0"),
    "grid_shape": (having(grid_shape=6), r"grid_shape: got 6, expected \(rows, columns\)"),
    "task": (of_spec(drop("task")), "observation_spec: it has no task"),
    "score": (of_spec(drop("score")), "observation_spec: it has no score"),
    "voxels": (of_spec(drop("voxels")), "observation_spec: expected 'voxels' and 'types'"),
    "actions of another width": (
        of_spec(lambda self, n, v: self.action_spec["action"].set("actuation", Bounded(0.6, 1.6, (n, v + 1)))),
        r"action_spec: 'actuation': got shape \[4, 13\], expected \[4, 12\]",
    ),
    "actions without bounds": (
        of_spec(lambda self, n, v: self.action_spec["action"].set("actuation", Unbounded((n, v)))),
        "action_spec: 'actuation': expected a Bounded spec",
    ),
    "actions of another name": (
        of_spec(lambda self, n, v: self.action_spec["action"].set("force", Bounded(0.0, 1.0, (n, v)))),
        "action_spec: got .*force",
    ),
    "wrong spec": (
        of_spec(
            lambda self, n, v: self.observation_spec.set("occupancy", Categorical(2, shape=(n, v), dtype=torch.int8))
        ),
        "reset: 'occupancy' is torch.bool .*, observation_spec says torch.int8",
    ),
    "flags that are numbers": (
        of_spec(lambda self, n, v: self.observation_spec.set("unstable", Unbounded((n, 1)))),
        "'unstable' is torch.bool .*, observation_spec says torch.float32",
    ),
    "not finite": (showing(nan), "reset: 'task' is not finite"),
    "actuators beyond the body": (
        showing(lambda self, shown: shown["actuators"].fill_(True)),
        "actuators: some are in cells that hold no voxel",
    ),
    "no actuators": (showing(lambda self, shown: shown["actuators"].fill_(False)), "actuators: a world has none"),
    "worlds of other designs": (OtherBodies, r"occupancy: world 1 differs from world 0; it holds body w % 1"),
    "ceiling of one number": (
        type("Mine", (ToyEnv,), {"score_ceiling": property(lambda self: 1.0)}),
        r"score_ceiling: got float64 of shape \(\)",
    ),
    "return at reset": (showing(lambda self, shown: shown["return"].add_(1.0)), "return: got .* at reset, expected 0"),
    "score with the last reward": (showing(scored), "env-step 3: 'score' is .*without the last reward"),
    "reward twice": (
        stepping(lambda self, stepped: stepped["reward"].mul_(2.0)),
        "env-step 1: 'return' is .*the sum of the episode's rewards",
    ),
    "reward of one number": (
        stepping(
            lambda self, stepped: stepped.set("reward", stepped["reward"].mean(0, keepdim=True).expand(4, 1) * 0 / 0)
        ),
        "'reward' is .*not finite",
    ),
    "never done": (stepping(lambda self, stepped: stepped["done"].fill_(False)), "env-step 3: 'done' is not"),
    "returns that are kept": (KeepsReturns, "return: a world that was reset after env-step 3 still has"),
    "no seed": (Unseeded, "another environment with the same seed shows other values"),
    "global draws": (GlobalNoise, "another environment with the same seed|it uses a global generator"),
    "a state without places": (Amnesic, "goes on from a saved state shows other values"),
}


@pytest.mark.parametrize("case", WRONG)
def test_mistakes_are_named(case):
    kind, message = WRONG[case]
    with pytest.raises(ValueError, match=f"(?s)^environment {kind.__name__}: .*(?:{message})"):
        check_env(partial(kind, SHORT, bodies=[SMALL, WIDE], noise=0.1))


def test_resets_of_others_that_change_a_world_are_named():
    class Uneven(ResetsAll):
        def _step(self, tensordict):
            stepped = super()._step(tensordict)
            self.reached = self.reached | (np.arange(len(self.x)) == 0)  # the first world ends in every step
            stepped["terminated"][0] = stepped["done"][0] = True
            return stepped

    with pytest.raises(ValueError, match=r"worlds that have not ended in env-step 1 are changed|'score' is"):
        check_env(partial(Uneven, noise=0.1))


def test_what_is_no_factory_is_refused():
    with pytest.raises(ValueError, match=r"make_env: got .*, expected what makes environments"):
        check_env(ToyEnv())
    with pytest.raises(ValueError, match="make_env: it returned 3"):
        check_env(lambda **_: 3)
    with pytest.raises(ValueError, match=r"environment PopulationEnv: .*(batch_size|observation_spec|action_spec)"):
        check_env(lambda num_worlds, seed: population_env("Walker-v0", [BODY] * num_worlds, seed=seed))
