"""Search for stiffness fields, on objectives that need no simulator."""

import numpy as np
import pytest

from evogymcm.algos.codesign import Design, Individual, MaterialSearch, perturb_stiffness
from evogymcm.body import Body, sample_body
from tests.algos.tools import through_json, through_torch

BODY = Body("HHRSV/SS.HH/R...V")
TARGET = np.linspace(0.6, 1.9, 15).reshape(3, 5)


def individual(index=0, fitness=None, body=BODY, stiffness=None):
    design = Design(body, stiffness)
    return Individual(index, design, fitness=quadratic(design.field, body) if fitness is None else fitness)


def quadratic(field, body=BODY):
    """A toy score: 0 where the voxels' stiffness is the target's, negative elsewhere."""
    return -float((np.log(field / TARGET)[body.occupancy] ** 2).sum())


def play(search, rounds=10**9):
    for _ in range(rounds):
        if search.is_finished:
            break
        search.tell([quadratic(field) for field in search.ask()])
    return search


def one_round(score, best=10.0, acceptance="reference"):
    """Whether a proposal's score is accepted."""
    search = MaterialSearch([individual(fitness=best)], seed=0, acceptance=acceptance)
    fields = search.ask()
    search.tell([score])
    is_accepted = np.array_equal(search.best.fields, fields)
    assert search.best.scores[0] == (score if is_accepted else best)
    return is_accepted


# Proposals


@pytest.mark.parametrize("noise", ["multiplicative", "additive"])
def test_noise_has_the_given_distribution(noise):
    # 10,000 fields of 9 voxels from the middle of the range, with little noise, so that nothing is clipped.
    body = Body("HHH/HHH/HHH")
    start = Design(body, np.full((3, 3), 1.2))
    rng = np.random.default_rng(0)
    fields = np.stack([perturb_stiffness(start, rng, 0.15, 0.05, noise) for _ in range(10_000)])
    errors = np.log(fields / 1.2) if noise == "multiplicative" else fields - 1.2
    is_changed = fields != 1.2
    # A voxel changes with probability p, or as the one that is picked where none is (q^9 of fields).
    expected = 0.15 + 0.85**9 / 9
    assert is_changed.mean() == pytest.approx(expected, abs=4 * np.sqrt(expected / 90_000))
    assert is_changed.any(axis=(1, 2)).all()
    np.testing.assert_allclose(is_changed.mean(axis=0), expected, atol=5 * np.sqrt(expected / 10_000))
    n = is_changed.sum()
    assert errors[is_changed].mean() == pytest.approx(0.0, abs=4 * 0.05 / np.sqrt(n))
    assert errors[is_changed].std() == pytest.approx(0.05, rel=4 / np.sqrt(2 * n))
    assert np.mean(is_changed.sum(axis=(1, 2)) == 1) == pytest.approx(9 * 0.15 * 0.85**8 + 0.85**9, abs=0.02)


@pytest.mark.parametrize("noise", ["multiplicative", "additive"])
def test_fields_stay_in_range_and_one_on_empty_cells(noise):
    rng = np.random.default_rng(1)
    design = Design(BODY, TARGET)
    for _ in range(200):
        design = Design(BODY, perturb_stiffness(design, rng, 0.5, 1.0, noise))
        assert (design.field[~BODY.occupancy] == 1.0).all()
    voxels = design.field[BODY.occupancy]
    assert voxels.min() == 0.5  # so strong a noise reaches both limits
    assert voxels.max() == 2.0


def test_probability_one_changes_all_voxels_and_zero_changes_one():
    rng = np.random.default_rng(2)
    start = Design(BODY)
    picked = set()
    for _ in range(100):
        assert ((perturb_stiffness(start, rng, 1.0) != 1.0) == BODY.occupancy).all()
        changed = np.flatnonzero(perturb_stiffness(start, rng, 0.0) != 1.0)
        assert len(changed) == 1
        picked.update(changed.tolist())
    assert picked == set(np.flatnonzero(BODY.occupancy).tolist())


# Acceptance


@pytest.mark.parametrize(
    ("best", "score", "reference", "paper"),
    [
        (10.0, 10.3, True, True),
        (10.0, 10.1, False, True),
        (10.0, 10.0, False, False),
        (10.0, 9.0, False, False),
        (-10.0, -9.7, True, True),  # 2 % of the absolute value: a margin below zero, too
        (-10.0, -9.9, False, True),
        (-10.0, -10.1, False, False),
        (0.0, 0.0, True, False),  # at zero the reference code takes an equal score
        (0.0, 1e-9, True, True),
        (0.0, -1e-9, False, False),
        (100.0, 102.0, True, True),  # the margin itself is enough
    ],
)
def test_acceptance(best, score, reference, paper):
    assert one_round(score, best, "reference") is reference
    assert one_round(score, best, "paper") is paper


def test_the_best_of_several_candidates_is_judged():
    search = MaterialSearch([individual(0, 1.0), individual(1, 1.0)], seed=0, candidates=3)
    fields = search.ask()
    assert fields.shape == (6, 3, 5)
    search.tell([1.5, 3.0, 2.0, 0.5, 1.01, -4.0])
    np.testing.assert_array_equal(search.best.scores, [3.0, 1.0])
    np.testing.assert_array_equal(search.best.fields[0], fields[1])
    np.testing.assert_array_equal(search.best.fields[1], np.ones((3, 5)))
    # The next proposals start from there.
    following = search.ask()
    assert (following[:3] == fields[1]).mean() > 0.5
    np.testing.assert_array_equal(search.history, [[1.0, 1.0], [3.0, 1.0]])


# Searching


@pytest.mark.parametrize("acceptance", ["reference", "paper"])
@pytest.mark.parametrize("noise", ["multiplicative", "additive"])
@pytest.mark.parametrize("candidates", [1, 8])
def test_hill_climbing_improves_and_never_lowers(acceptance, noise, candidates):
    items = [individual(index) for index in range(4)]
    search = MaterialSearch(items, seed=0, rounds=60, candidates=candidates, acceptance=acceptance, noise=noise)
    play(search)
    assert search.n_rounds == 60
    assert search.history.shape == (61, 4)
    assert (np.diff(search.history, axis=0) >= 0).all()
    assert (search.best.scores > 0.6 * search.history[0]).all()  # from -1.9; 0 is the optimum
    np.testing.assert_array_equal(search.best.scores, [quadratic(field) for field in search.best.fields])


def test_more_candidates_find_more_in_as_many_rounds():
    items = [individual(index) for index in range(6)]
    few, many = (play(MaterialSearch(items, seed=1, candidates=n)) for n in (1, 10))
    assert many.best.scores.mean() > few.best.scores.mean()


def test_bodies_may_differ_and_hold_fields_already():
    rng = np.random.default_rng(0)
    bodies = [sample_body((3, 5), rng) for _ in range(5)]
    items = [individual(index, 0.0, body, rng.uniform(0.5, 2.0, (3, 5))) for index, body in enumerate(bodies)]
    search = MaterialSearch(items, seed=0)
    for field, item in zip(search.ask(), items, strict=True):
        occupied = item.design.body.occupancy
        assert (field[~occupied] == 1.0).all()
        assert 0 < (field[occupied] != item.design.field[occupied]).mean() < 0.7


@pytest.mark.parametrize("proposal", ["hill-climbing", "cma"])
def test_a_survivors_search_does_not_depend_on_the_others(proposal):
    if proposal == "cma":
        pytest.importorskip("cma")
    options = {"seed": (3, 1), "candidates": 4, "proposal": proposal}
    together = play(MaterialSearch([individual(index) for index in (7, 2, 5)], **options))
    alone = play(MaterialSearch([individual(2)], **options))
    np.testing.assert_array_equal(together.best.fields[1], alone.best.fields[0])
    np.testing.assert_array_equal(together.history[:, 1], alone.history[:, 0])
    assert len({field.tobytes() for field in together.best.fields}) == 3
    other = play(MaterialSearch([individual(2)], **(options | {"seed": (3, 2)})))
    assert not np.array_equal(other.best.fields, alone.best.fields)


# CMA-ES


def test_cma_beats_hill_climbing_on_a_quadratic():
    # With few candidates it is clearly ahead; with ten and more in only 20 rounds, hill climbing is as good.
    pytest.importorskip("cma")
    options = {"seed": 0, "rounds": 20, "candidates": 4, "acceptance": "paper"}
    items = [individual(index) for index in range(20)]
    climbed = play(MaterialSearch(items, **options))
    evolved = play(MaterialSearch(items, proposal="cma", **options))
    gained = evolved.best.scores - climbed.best.scores
    assert gained.mean() > 2 * gained.std() / np.sqrt(20)
    assert (np.diff(evolved.history, axis=0) >= 0).all()


def test_cma_converges():
    pytest.importorskip("cma")
    items = [individual(index) for index in range(5)]
    search = play(MaterialSearch(items, seed=0, rounds=60, candidates=12, acceptance="paper", proposal="cma"))
    assert (search.best.scores > 0.005 * search.history[0]).all()


def test_cma_keeps_to_the_range_and_to_the_body():
    pytest.importorskip("cma")
    limits = np.where(np.arange(15).reshape(3, 5) % 2 == 0, 0.5, 2.0)  # begins on the border
    search = MaterialSearch([individual(0, 0.0, stiffness=limits)], seed=0, candidates=6, sigma=1.0, proposal="cma")
    while not search.is_finished:
        fields = search.ask()
        assert ((fields >= 0.5) & (fields <= 2.0)).all()
        assert (fields[:, ~BODY.occupancy] == 1.0).all()
        search.tell(fields[:, 0, 0])
    assert search.best.scores[0] > 1.9


@pytest.mark.parametrize("body", ["H", "HV"])
def test_cma_copes_with_tiny_bodies_and_flat_scores(body):
    pytest.importorskip("cma")
    search = MaterialSearch([individual(0, 1.0, Body(body))], seed=0, candidates=2, proposal="cma")
    while not search.is_finished:
        search.tell(np.zeros(len(search.ask())))
    np.testing.assert_array_equal(search.best.scores, [1.0])


@pytest.mark.filterwarnings("ignore:.*Initial standard deviation")
@pytest.mark.parametrize("sigma", [0.2, 1.0, 5.0])
def test_cma_takes_large_steps_over_one_voxel_too(sigma):
    people = [Individual(0, Design(Body("H.")), fitness=0.0)]
    search = MaterialSearch(people, seed=0, proposal="cma", candidates=2, rounds=20, sigma=sigma)
    while not search.is_finished:
        fields = search.ask()
        assert ((fields[:, 0, 0] >= 0.5) & (fields[:, 0, 0] <= 2.0)).all()
        search.tell(np.abs(np.log(fields[:, 0, 0])))


def test_cma_leaves_the_global_generator_alone():
    pytest.importorskip("cma")
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    play(MaterialSearch([individual()], seed=0, candidates=4, proposal="cma"))
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


# Stopping and going on


@pytest.mark.parametrize("carry", [through_json, through_torch])
@pytest.mark.parametrize("proposal", ["hill-climbing", "cma"])
@pytest.mark.parametrize("is_asked", [False, True])
def test_a_resumed_search_equals_an_uninterrupted_one(carry, proposal, is_asked):
    if proposal == "cma":
        pytest.importorskip("cma")

    def make():
        items = [individual(index, stiffness=TARGET[::-1]) for index in (4, 9)]
        return MaterialSearch(items, seed=(6, np.int64(2)), candidates=3, proposal=proposal)

    whole = play(make(), 7)
    if is_asked:
        whole.ask()
    state = carry(whole.state_dict())
    resumed = play(make(), 2)  # whatever it did before
    resumed.load_state_dict(state)
    np.testing.assert_array_equal(resumed.history, whole.history)
    play(whole)
    play(resumed)
    np.testing.assert_array_equal(resumed.best.fields, whole.best.fields)
    np.testing.assert_array_equal(resumed.history, whole.history)
    assert resumed.state_dict() == whole.state_dict()
    assert not np.array_equal(whole.history[7], whole.history[-1])


def test_a_state_of_other_settings_is_refused():
    state = MaterialSearch([individual()], seed=0).state_dict()
    with pytest.raises(ValueError, match="rounds: got 5, the state has 20"):
        MaterialSearch([individual()], seed=0, rounds=5).load_state_dict(state)
    with pytest.raises(ValueError, match="individuals: got"):
        MaterialSearch([individual(1)], seed=0).load_state_dict(state)


def test_asking_again_gives_the_same_and_the_end_is_an_error():
    search = MaterialSearch([individual()], seed=0, rounds=1)
    with pytest.raises(RuntimeError, match="nothing has been asked"):
        search.tell([1.0])
    np.testing.assert_array_equal(search.ask(), search.ask())
    search.tell([-1.0])
    assert search.is_finished
    with pytest.raises(RuntimeError, match="all 1 rounds are over"):
        search.ask()


# Bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"individuals": []}, "got none"),
        ({"individuals": [individual(1), individual(1)]}, "each may occur once"),
        ({"individuals": [individual(0), individual(1, 0.0, Body("HH"))]}, "all must be equal"),
        ({"individuals": [Individual(3, Design(BODY))]}, r"\[3\] have no fitness"),
        ({"rounds": 0}, "rounds: got 0"),
        ({"candidates": 0}, "candidates: got 0"),
        ({"candidates": 1, "proposal": "cma"}, "at least 2"),
        ({"probability": 1.1}, "probability: got 1.1"),
        ({"probability": np.nan}, "probability: got nan"),
        ({"sigma": 0.0}, r"sigma: got 0\.0"),
        ({"sigma": np.inf}, "sigma: got inf"),
        ({"acceptance": "any"}, "acceptance: got 'any', allowed are reference, paper"),
        ({"noise": "white"}, "noise: got 'white', allowed are multiplicative, additive"),
        ({"proposal": "random"}, "proposal: got 'random', allowed are hill-climbing, cma"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        MaterialSearch(**({"individuals": [individual()], "seed": 0} | arguments))


@pytest.mark.parametrize("scores", [[1.0], [1.0, 2.0, 3.0], [[1.0], [2.0]], [1.0, np.nan], [np.inf, 1.0]])
def test_bad_scores_are_refused_and_change_nothing(scores):
    search = MaterialSearch([individual(0), individual(1)], seed=0)
    fields = search.ask()
    before = search.state_dict()
    with pytest.raises(ValueError, match="expected 2 finite numbers"):
        search.tell(scores)
    assert search.state_dict() == before
    np.testing.assert_array_equal(search.ask(), fields)


def test_noise_of_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="noise: got 'white'"):
        perturb_stiffness(Design(BODY), np.random.default_rng(0), noise="white")
