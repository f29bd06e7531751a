"""Co-design with every method, with and without inheritance and sharing; whose policy a child starts from."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
import torch

import evogymcm as cm
from evogymcm.algos import BodyPPOConfig, RunFolder, evaluate, load_actor
from evogymcm.algos.codesign import (
    CodesignConfig,
    Design,
    SearchConfig,
    codesign,
    cost_of,
    score_alone,
    train_designs,
)
from evogymcm.algos.codesign.inner_loop import holding
from evogymcm.algos.codesign.scoring import score_together
from evogymcm.algos.codesign.start import env_maker
from evogymcm.envs import SoftRobotEnv
from tests.algos.codesign.test_codesign import TINY, told
from tests.registries import registered

PPO = BodyPPOConfig(total_steps=32, num_worlds=2, rollout_steps=8, epochs=1, minibatch=16, hidden=4, eval_interval=0)
QUICK = CodesignConfig(
    "Blink-v0", material="invariant", search=SearchConfig(rounds=1), finetune_steps=16, shape=(2, 3), population=4,
    budget=8, ppo=PPO,
)  # fmt: skip
METHODS = {
    "ga": {"method": "ga"},
    "random": {"method": "random"},
    "qd": {"method": "qd"},
    "halving": {"method": "ga", "rungs": (0.5,), "keep": (0.5,)},
}

if "Blink-v0" not in cm.tasks:
    cm.register_task(replace(cm.tasks["Dash-v0"], id="Blink-v0", time_limit=5))


@pytest.fixture
def zigzag():
    """A task whose goals are drawn at reset, while it is registered."""
    with registered(replace(cm.tasks["BidirectionalWalker-v0"], id="Zigzag-v0", time_limit=12)) as name:
        yield name


def ways():
    """All methods, each with and without inheritance and sharing; those that cross nothing new are slow tests."""
    more = {("random", False, "shared"), ("qd", False, "independent"), ("halving", False, "independent")}
    more |= {("halving", False, "shared")}
    for way in product(METHODS, (False, True), ("independent", "shared")):
        yield pytest.param(*way, marks=pytest.mark.slow) if way in more else way


@pytest.mark.parametrize(("method", "inherit", "sharing"), list(ways()))
def test_every_method_runs_or_says_why_not(method, inherit, sharing, tmp_path):
    if method == "qd":
        pytest.importorskip("ribs")
    changes = METHODS[method] | {"inherit": inherit, "ppo": replace(PPO, sharing=sharing)}
    if inherit and (method == "random" or sharing == "shared"):
        with pytest.raises(ValueError, match=r"inherit: got True, but .*(no parents|one policy, which cannot start)"):
            replace(QUICK, **changes)
        return
    config = replace(QUICK, **changes)
    run = RunFolder(tmp_path / "run", {})
    result = codesign(config, run=run)
    assert result.finished
    assert len({row["body"] for row in result.rows}) == 8
    if inherit:
        assert told(codesign(config)) == told(result)  # without a folder, where policies come from memory
    last = {row["index"]: row for row in result.rows}
    again = score_alone(
        env_maker(config),
        [Design.from_record(row) for row in last.values()],
        [run.load(f"policy-{index:04}") for index in last],
    )
    assert again.score.tolist() == [row["fitness"] for row in last.values()]


def test_children_of_old_elites_start_from_their_own_parents_policy(tmp_path):
    pytest.importorskip("ribs")
    ppo = replace(PPO, learning_rate=1e-12)  # with hardly any learning, a child's weights are its parent's
    config = replace(
        QUICK, material="reactive", search=None, method="qd", inherit=True, population=3, budget=15, ppo=ppo
    )
    run = RunFolder(tmp_path / "run", {})
    rows = {row["index"]: row for row in codesign(config, run=run).rows}
    children = [row for row in rows.values() if row["parent"] is not None]
    assert len(children) == 12
    assert any(rows[row["parent"]]["generation"] < row["generation"] - 1 for row in children)
    firsts = [run.load(f"policy-{index:04}")["actor"]["local.weight"] for index in range(3)]
    for row in children:
        own, parent = (run.load(f"policy-{row[key]:04}")["actor"]["local.weight"] for key in ("index", "parent"))
        torch.testing.assert_close(own, parent, atol=1e-6, rtol=1e-6)
        assert sum(torch.allclose(own, first, atol=1e-6) for first in firsts) == 1


def test_a_shared_policy_cannot_start_from_several():
    make_env = partial(SoftRobotEnv, TINY.task)
    designs = [Design(cm.Body(text)) for text in ("HVH/S.R", "HHH/V.V")]
    apart = train_designs(make_env, designs, PPO).last
    shared = replace(PPO, sharing="shared")
    with pytest.raises(ValueError, match="initial: got different policies, but a shared policy can start from one"):
        train_designs(make_env, designs, shared, initial=apart)
    with pytest.raises(ValueError, match="initial: got 1 policies, expected one for each of 2 designs"):
        train_designs(make_env, designs, shared, initial=apart[:1])
    for score, given in ((score_alone, (designs, apart[:1])), (score_together, ([designs], apart))):
        with pytest.raises(ValueError, match=r"policies: got \d, expected"):
            score(make_env, *given)
    assert train_designs(make_env, designs, shared, initial=[apart[0], dict(apart[0])]).finished


def test_scores_do_not_depend_on_who_stands_beside_where_resets_are_random(zigzag):
    make_env = partial(SoftRobotEnv, zigzag)
    designs = [Design(cm.Body("HVH/S.R"))] * 4
    policies = train_designs(make_env, designs[:1], PPO).best * 4
    scores = [score_alone(make_env, designs, policies, seed).score for seed in range(4)]
    assert all(len(set(row.tolist())) == 1 for row in scores)
    assert len({row[0] for row in scores}) > 1  # the draws do matter
    assert score_alone(make_env, designs[:1], policies[:1]).score[0] == scores[0][0]
    together = score_together(make_env, [designs], policies[:1], seed=3).score
    assert together[0] == pytest.approx(scores[3], abs=1e-6)


def test_scores_are_means_over_eight_draws_where_resets_are_random(zigzag):
    make_env, design = partial(SoftRobotEnv, zigzag), Design(cm.Body("HVH/S.R"))
    trained = train_designs(make_env, [design], PPO)
    result, single = score_alone(make_env, [design], trained.best, seed=5), []
    for seed in range(5, 13):
        env = holding(make_env, [design])(num_worlds=1, seed=seed)
        actor = load_actor(trained.best[0])
        actor.columns = env.grid_shape[1]
        single.append(evaluate(actor, env))
    assert result.env_steps == 8 * 12
    for mean, name in ((result.score, "score"), (result.returns, "returns")):
        parts = [getattr(one, name)[0] for one in single]
        assert len(set(parts)) > 1
        assert mean[0] == pytest.approx(np.mean(parts), abs=1e-9)
    config = replace(QUICK, task=zigzag, search=None, inherit=True, mutants=2)
    assert codesign(config).env_steps == cost_of(config).total
    assert train_designs(make_env, [design] * 3, replace(PPO, sharing="shared")).scores.shape == (3,)
