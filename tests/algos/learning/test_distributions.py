"""Action distributions against torch's closed forms."""

import pytest
import torch
from tensordict import TensorDict
from torch.distributions import AffineTransform, Normal, TransformedDistribution

from evogymcm.algos.learning import MaskedClippedNormal, VoxelActions
from evogymcm.algos.learning.distributions import IDLE

LOW, HIGH = 0.6, 1.6


def _head(batch: int = 5, voxels: int = 7, low: float = LOW, high: float = HIGH) -> MaskedClippedNormal:
    generator = torch.Generator().manual_seed(0)
    loc = torch.randn(batch, voxels, generator=generator, dtype=torch.float64)
    scale = torch.rand(batch, voxels, generator=generator, dtype=torch.float64) + 0.1
    mask = torch.rand(batch, voxels, generator=generator) < 0.6
    return MaskedClippedNormal(loc, scale, mask, low, high)


def _reference(head: MaskedClippedNormal) -> TransformedDistribution:
    """Before clipping."""
    return TransformedDistribution(
        Normal(head.loc, head.scale), [AffineTransform((head.low + head.high) / 2, (head.high - head.low) / 2)]
    )


def test_log_prob_is_torchs_over_the_driven_voxels():
    head = _head()
    actions = head.rsample()
    actions = torch.where(head.mask, actions, 1.234)  # what stands on other voxels must not matter
    reference = _reference(head)
    log_density = reference.log_prob(actions)
    low = reference.cdf(torch.full_like(actions, LOW)).log()
    high = (1 - reference.cdf(torch.full_like(actions, HIGH))).log()
    expected = torch.where(actions == LOW, low, torch.where(actions == HIGH, high, log_density))
    assert (actions == LOW).any()
    assert (actions == HIGH).any()
    torch.testing.assert_close(head.log_prob(actions), (expected * head.mask).sum(-1))


def test_entropy_is_the_gaussians_over_the_driven_voxels():
    head = _head()
    torch.testing.assert_close(head.entropy(), (Normal(head.loc, head.scale).entropy() * head.mask).sum(-1))


def test_density_and_bounds_add_up_to_one():
    head = MaskedClippedNormal(torch.tensor([0.3]), torch.tensor([0.7]), torch.tensor([True]), 0.5, 2.0)
    grid = torch.linspace(0.5, 2.0, 20_001, dtype=torch.float64)[1:-1].unsqueeze(-1)
    density = torch.trapezoid(head.log_prob(grid).exp(), grid.squeeze(-1))
    bounds = head.log_prob(torch.tensor([[0.5], [2.0]])).exp().sum()
    assert (density + bounds).item() == pytest.approx(1, abs=1e-3)
    assert 0.1 < bounds < 0.5


@pytest.mark.parametrize("loc", [-1.5, 0.2, 1.5])
def test_bounds_are_drawn_as_often_as_log_prob_says(loc):
    torch.manual_seed(0)
    head = MaskedClippedNormal(torch.tensor([loc]), torch.tensor([0.6]), torch.tensor([True]), LOW, HIGH)
    draws = head.rsample(torch.Size([100_000]))
    for bound in (LOW, HIGH):
        expected = head.log_prob(torch.tensor([bound])).exp().item()
        assert (draws == bound).double().mean().item() == pytest.approx(expected, abs=0.01)


def test_a_mean_beyond_the_bound_holds_it():
    head = MaskedClippedNormal(torch.tensor([-1.2]), torch.tensor([0.1]), torch.tensor([True]), LOW, HIGH)
    assert head.mode.item() == pytest.approx(LOW, abs=1e-7)


def test_samples_stay_in_range_and_idle_elsewhere():
    head = _head()
    draws = head.rsample(torch.Size([1000]))
    driven = draws[:, head.mask]
    assert draws.shape == (1000, 5, 7)
    assert driven.min() >= LOW
    assert driven.max() <= HIGH
    assert (draws[:, ~head.mask] == IDLE).all()
    assert (head.mode[~head.mask] == IDLE).all()


@pytest.mark.parametrize("bound", [LOW, HIGH])
def test_log_prob_and_gradient_on_the_bounds_are_finite(bound):
    loc = torch.zeros(1, 2, requires_grad=True)
    head = MaskedClippedNormal(loc, torch.tensor(0.5), torch.ones(1, 2, dtype=torch.bool), LOW, HIGH)
    log_prob = head.log_prob(torch.full((1, 2), bound))
    log_prob.sum().backward()
    assert log_prob.isfinite().all()
    assert loc.grad.isfinite().all()


def test_padding_gets_no_gradient():
    loc = torch.zeros(1, 3, requires_grad=True)
    mask = torch.tensor([[True, False, True]])
    head = MaskedClippedNormal(loc, torch.tensor(0.5), mask, LOW, HIGH)
    (head.log_prob(torch.full((1, 3), 1.3)) + head.entropy()).sum().backward()
    assert loc.grad[0, 1] == 0
    assert (loc.grad[0, ::2] != 0).all()


def test_joint_is_the_sum_of_its_heads():
    heads = {"actuation": _head(), "stiffness": _head(low=0.5, high=2.0)}
    joint = VoxelActions(heads)
    action = joint.sample()
    assert isinstance(action, TensorDict)
    assert action.batch_size == (5,)
    expected = sum(head.log_prob(action[name]) for name, head in heads.items())
    torch.testing.assert_close(joint.log_prob(action), expected)
    torch.testing.assert_close(joint.entropy(), sum(head.entropy() for head in heads.values()))
    assert joint.sample(torch.Size([3])).batch_size == (3, 5)
    torch.testing.assert_close(joint.mode["stiffness"], heads["stiffness"].mode)
