"""Training of drawn settings, stopped after any update: it goes on as if it had not been."""

from dataclasses import replace
from functools import partial

import torch
from hypothesis import given
from hypothesis import strategies as st

from evogymcm.algos import PPOConfig, Trainer
from tests.algos.tools import through_torch
from tests.algos.toy_env import SMALL, WIDE, ToyEnv, ToyTask

TINY = PPOConfig(total_steps=96, num_worlds=4, rollout_steps=6, epochs=1, minibatch=12, hidden=4, eval_interval=0)


@st.composite
def settings(draw):
    """Settings of tiny runs, of all kinds."""
    return replace(
        TINY,
        context=draw(st.sampled_from(["none", "body", "message", "attention"])),
        sharing=draw(st.sampled_from(["shared", "independent"])),
        noise_correlation=draw(st.sampled_from([0.0, 0.9])),
        target_kl=draw(st.sampled_from([0.0, 0.02])),
        seed=draw(st.integers(0, 2**31)),
    )


def leaves(state):
    """All that a state holds, in order, but for how long it has taken."""
    if isinstance(state, dict):
        return [leaf for name, part in state.items() if name != "seconds" for leaf in leaves(part)]
    if isinstance(state, list | tuple):
        return [leaf for part in state for leaf in leaves(part)]
    return [state.clone() if isinstance(state, torch.Tensor) else state]


def equal(one, other):
    pairs = zip(leaves(one), leaves(other), strict=True)
    return all(torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in pairs)


@given(settings(), st.sampled_from(["invariant", "reactive"]), st.integers(1, 9), st.integers(0, 3), st.booleans())
def test_a_run_goes_on_after_any_update(config, material, time_limit, cut, evaluates):
    make = partial(ToyEnv, ToyTask(time_limit=time_limit), bodies=[SMALL, WIDE], noise=0.1, material=material)
    with Trainer(make, config) as whole, Trainer(make, config) as resumed:
        if evaluates:
            resumed.update()  # whatever it did before
        updates = 0
        while not whole.is_finished:
            if evaluates and updates == cut:
                whole.take_best(whole.evaluate())
            if updates == cut:
                resumed.load_state_dict(through_torch(whole.state_dict()))
            whole.update()
            updates += 1
            if updates > cut:
                resumed.update()
                assert equal(resumed.state_dict(), whole.state_dict())
        assert resumed.is_finished
