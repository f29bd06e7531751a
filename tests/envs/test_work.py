"""Work of actuation and stiffness, as environments measure, tell and charge it."""

import numpy as np
import pytest
from torchrl.envs import check_env_specs

from evogymcm.envs import BodiesParallelEnv, PopulationEnv, SoftRobotEnv
from tests.envs.tools import (
    SMALL,
    WIDE,
    assert_same,
    make_engine,
    make_gymnasium,
    make_vec,
    outputs,
    random_actions,
    step_randomly,
)

NAMES = ["actuation_work", "stiffness_work", "net_actuation_work", "net_stiffness_work"]
STEPS = 4


def reactive(bodies=SMALL, num_worlds=None, **options):
    return make_engine("Walker-v0", bodies, num_worlds, material="reactive", **options)


def test_measured_work_changes_nothing_else_and_by_default_there_is_none():
    plain, measured = reactive([SMALL, WIDE]), reactive([SMALL, WIDE], work_weight=0)
    for engine in (plain, measured):
        step_randomly(engine, STEPS)
    assert_same(outputs(measured), outputs(plain))
    assert plain.work is None
    assert plain.works == {}
    assert "work" not in plain.state()
    assert list(measured.works) == NAMES
    supplied, net = measured.work[:, :2], measured.work[:, 2:]
    assert (supplied > 0).all()
    assert (supplied > net).all()


def test_supplied_work_costs_its_weight_in_reward_but_not_in_score():
    plain, free = reactive(), reactive(work_weight=0)
    dear = {weight: reactive(work_weight=weight) for weight in (1e-3, (1e-3, 0), (0, 2e-3))}
    actuation, stiffness = random_actions(plain, STEPS)
    before = np.zeros(4)
    for step in range(STEPS):
        for engine in (plain, free, *dear.values()):
            engine.step(actuation[step], stiffness[step])
        by_actuation, by_stiffness = free.work[0, :2] - before[:2]
        before = free.work[0]
        assert free.reward.tolist() == plain.reward.tolist()
        costs = {w: (plain.reward - engine.reward).item() for w, engine in dear.items()}
        expected = (1e-3 * (by_actuation + by_stiffness), 1e-3 * by_actuation, 2e-3 * by_stiffness)
        assert costs == pytest.approx(dict(zip(dear, expected, strict=True)))
    for engine in dear.values():
        assert (engine.score.item(), engine.returns.item()) == (plain.score.item(), plain.returns.item())


def test_stiffness_that_holds_still_does_no_work():
    field = np.full((2, 3), 1.7)
    invariant, constant = make_engine(bodies=SMALL, stiffness=field, work_weight=0), reactive(work_weight=0)
    for actuation in random_actions(constant, STEPS)[0]:
        invariant.step(actuation)
        before = constant.work.copy()
        constant.step(actuation, np.full((1, 6), 1.7))
    assert invariant.work[0, 1] == invariant.work[0, 3] == 0 < invariant.work[0, 0]
    assert constant.work[0, [1, 3]].tolist() == before[0, [1, 3]].tolist()  # from 1 to 1.7 it went in the first step
    assert before[0, 1] > 0


def test_work_is_a_worlds_own_and_begins_anew_with_its_episode():
    batch = reactive([SMALL, WIDE, SMALL], work_weight=0)
    alone = reactive(WIDE, work_weight=0, grid_shape=batch.grid_shape)
    actions = list(zip(*random_actions(batch, STEPS), strict=True))
    again = np.array([False, True, False])
    for engine, rows in ((batch, [0, 1, 2]), (alone, [1])):
        for actuation, stiffness in actions:
            engine.step(actuation[rows], stiffness[rows])
        engine.reset(again[rows])
        assert (engine.work[again[rows]] == 0).all()
        others = engine.work[~again[rows]].copy()
        for actuation, stiffness in actions:
            engine.step(actuation[rows], stiffness[rows], again[rows])
        assert engine.work[~again[rows]].tolist() == others.tolist()
    assert batch.work[1].tolist() == alone.work[0].tolist()
    fresh = reactive(WIDE, work_weight=0, grid_shape=batch.grid_shape)  # also after another episode
    for actuation, stiffness in actions:
        fresh.step(actuation[1:2], stiffness[1:2])
    assert fresh.work.tolist() == alone.work.tolist()


def test_a_saved_state_goes_on_with_its_work():
    one, other = (reactive([SMALL, WIDE], work_weight=1e-3, seed=seed) for seed in range(2))
    step_randomly(one, STEPS)
    other.set_state(one.state())
    for engine in (one, other):
        step_randomly(engine, 1, seed=1)
    assert other.work.tolist() == one.work.tolist()
    assert other.reward.tolist() == one.reward.tolist()
    with pytest.raises(ValueError, match="state: it has no 'work'"):
        other.set_state(reactive([SMALL, WIDE]).state())


def test_every_environment_tells_and_charges_the_work_of_its_engine():
    options = {"material": "reactive", "work_weight": 1e-3}
    env = make_gymnasium(body=SMALL, **options)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(STEPS):
        _, reward, _, _, info = env.step(env.action_space.sample())
    engine = env.unwrapped.engine
    assert [info[name] for name in NAMES] == engine.work[0].tolist()
    assert reward == engine.reward[0] < engine.returns[0] - engine.score[0]

    envs = make_vec(body=SMALL, num_envs=2, **options)
    envs.reset(seed=0)
    _, rewards, _, _, info = envs.step(envs.action_space.sample())
    assert np.stack([info[name] for name in NAMES], axis=1).tolist() == envs.engine.work.tolist()
    assert rewards.tolist() == envs.engine.reward.tolist()

    agents = BodiesParallelEnv("Walker-v0", [SMALL, WIDE], **options)
    agents.reset(seed=0)
    _, _, _, _, infos = agents.step({agent: agents.action_space(agent).sample() for agent in agents.agents})
    told = [[infos[agent][name] for name in NAMES] for agent in agents.possible_agents]
    assert told == agents.engine.work.tolist()

    for made, group in ((SoftRobotEnv, ()), (PopulationEnv, ("bodies",))):
        torchrl = made("Walker-v0", [SMALL, WIDE], **options)
        last = torchrl.rollout(STEPS)[..., -1]
        assert [last[("next", *group, name)].ravel().tolist() for name in NAMES] == torchrl.engine.work.T.tolist()
        assert set(NAMES) <= set(torchrl.observation_spec[group].keys() if group else torchrl.observation_spec.keys())
        check_env_specs(torchrl)


@pytest.mark.parametrize("weight", [-1.0, (1.0, -1.0), (1.0,), "much", float("nan"), True, (1.0, 2.0, 3.0)])
def test_weights_that_cannot_be_are_refused(weight):
    with pytest.raises(ValueError, match="work_weight: got "):
        reactive(work_weight=weight)
