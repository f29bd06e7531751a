"""Gaits: waves by hand, the search for them, and their files."""

import json
import math

import numpy as np
import pytest

from evogymcm.algos.gaits import GaitConfig, Waves, load_gaits, save_gaits, search_gaits
from evogymcm.algos.learning import evaluate
from evogymcm.envs import SoftRobotEnv, TaskEngine

pytest.importorskip("cma")
BODIES = ["HHH/V.V", "VVV/H.H"]
TINY = GaitConfig(env_steps=5_000, first=4, candidates=2, trial_steps=20, early=0.1, seed=3)


@pytest.fixture(scope="module")
def found():
    return search_gaits("Walker-v0", BODIES, TINY, num_threads=1)


def test_a_wave_is_that_of_the_formula():
    engine = TaskEngine("Walker-v0", ["HHS/V.V", "VH"], 2, material="reactive", grid_shape=(2, 4))
    values = np.zeros((1, 14))
    values[0, 1], values[0, 3], values[0, 5], values[0, 8] = 0.5, 1.0, -1.0, 1.0  # along, lead, offset_v, growth
    values[0, 7] = -1.25  # swing_v: 0.5, which stays within the range
    values[0, 9:13] = 0.5, 1.0, -2.0, 0.2  # level, along, down, pulse
    gait = Waves(values)
    still = gait(engine)
    for _ in range(3):
        engine.step(*gait(engine))
    actuation, stiffness = gait(engine)
    phase = 2 * math.pi * 3 / math.exp(2.2)

    def expected(x, y, is_horizontal):
        swing, lead, offset = (1.5, 1.5, 0.0) if is_horizontal else (0.5, 0.0, -0.3)
        wave = (swing * math.sin(phase + 0.3 * x + lead) + offset) * (1 + 0.3 * x)
        return 1.1 + 0.5 * min(max(wave, -1.0), 1.0)

    def factor(x, y):
        power = 0.15 + 0.15 * x - 0.3 * y + 0.1 * math.sin(phase + 0.3 * x)
        return 2.0 ** min(max(power, -1.0), 1.0)

    assert actuation[0, 0] == pytest.approx(expected(-1, -0.5, True), abs=1e-12)
    assert actuation[0, 4] == pytest.approx(expected(-1, 0.5, False), abs=1e-12)  # the second row of four columns
    assert actuation[0, 6] == pytest.approx(expected(1, 0.5, False), abs=1e-12)
    assert actuation[1, 0] == pytest.approx(expected(-0.5, 0, False), abs=1e-12)
    assert actuation[1, 1] == pytest.approx(expected(0.5, 0, True), abs=1e-12)
    assert stiffness[0, 2] == pytest.approx(factor(1, -0.5), abs=1e-12)
    assert stiffness[1, 1] == pytest.approx(factor(0.5, 0), abs=1e-12)
    assert not np.array_equal(still[0], actuation)
    assert gait.settings[0]["period"] == pytest.approx(math.exp(2.2))
    engine.close()


def test_scores_are_those_of_evaluations(found):
    for env in (TaskEngine("Walker-v0", BODIES), SoftRobotEnv("Walker-v0", BODIES, 4)):
        result = evaluate(found.waves, env)
        assert np.array_equal(result.score[:2], found.score)
        env.close()
    assert found.finished
    assert (found.env_steps <= TINY.env_steps).all()


def test_a_gait_depends_on_its_own_body_and_the_seed_alone(found):
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    alone = search_gaits("Walker-v0", BODIES[0], TINY, num_threads=2)
    assert np.array_equal(np.random.get_state()[1], state)  # noqa: NPY002
    assert np.array_equal(alone.waves.values[0], found.waves.values[0])
    assert alone.score[0] == found.score[0]
    other = search_gaits("Walker-v0", BODIES[0], GaitConfig(**vars(TINY) | {"seed": 4}), num_threads=2)
    assert not np.array_equal(other.waves.values, alone.waves.values)


def test_the_best_so_far_never_gets_worse_and_is_played_again_for_whole_episodes(found):
    lengths = [length for _, length, _ in found.curve]
    assert lengths == sorted(lengths)
    assert set(lengths) == {20, 500}
    for length in (20, 500):
        best = np.array([scores for _, played, scores in found.curve if played == length])
        assert (np.diff(best, axis=0) >= 0).all()
    short = [scores for _, played, scores in found.curve if played == 20][-1]
    leader = TaskEngine("Walker-v0", BODIES)
    first = search_gaits("Walker-v0", BODIES, TINY, should_stop=lambda: True)
    assert not first.finished
    for _ in range(20):
        leader.step(*first.waves(leader))
    assert np.array_equal(leader.score, first.score)
    assert (short >= first.score).all()
    leader.close()


def test_a_search_beats_its_own_first_gaits():
    config = GaitConfig(env_steps=20_000, first=8, candidates=4, trial_steps=None, seed=1)
    found = search_gaits("Walker-v0", BODIES, config, material="reactive")
    assert found.waves.values.shape == (2, 14)
    assert found.score.mean() > found.curve[0][2].mean() + 0.1


def test_what_tasks_draw_is_the_same_for_a_generation():
    config = GaitConfig(env_steps=10_000, first=3, candidates=2, trial_steps=30, early=0.02, seed=2)
    one, two = (search_gaits("BidirectionalWalker-v0", BODIES[0], config, num_threads=n) for n in (1, 2))
    assert np.array_equal(one.score, two.score)


def test_gaits_come_back_from_their_file(found, tmp_path):
    path = tmp_path / "gaits.json"
    save_gaits(path, found, "Walker-v0", BODIES)
    saved = load_gaits(path)
    assert [body.text for body in saved.bodies] == BODIES
    assert np.array_equal(saved.waves.values, found.waves.values)
    engine = saved.make_engine()
    assert np.array_equal(evaluate(saved.waves, engine).score, saved.score)
    engine.close()
    assert [file.name for file in tmp_path.iterdir()] == ["gaits.json"]
    with pytest.raises(ValueError, match="bodies: got 1, expected one for each of 2"):
        save_gaits(path, found, "Walker-v0", BODIES[:1])


def test_stiffness_is_kept_with_the_gait(tmp_path):
    fields = [np.full((2, 3), 2.0)]
    found = search_gaits("Walker-v0", BODIES[0], TINY, stiffness=fields)
    assert found.score != search_gaits("Walker-v0", BODIES[0], TINY).score
    save_gaits(tmp_path / "stiff.json", found, "Walker-v0", BODIES[:1], stiffness=fields)
    saved = load_gaits(tmp_path / "stiff.json")
    engine = saved.make_engine()
    assert evaluate(saved.waves, engine).score == found.score
    engine.close()


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"kind": "gaits"}', '{"kind": "other"}'])
def test_other_files_are_no_gaits(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"gaits: .*x\.json cannot be read"):
        load_gaits(path)


def test_a_file_with_numbers_missing_is_no_gaits(found, tmp_path):
    path = tmp_path / "gaits.json"
    save_gaits(path, found, "Walker-v0", BODIES)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"values": found.waves.values[:1].tolist()}))
    with pytest.raises(ValueError, match="cannot be read"):
        load_gaits(path)


def test_bad_input_says_so():
    for values in (np.zeros(9), np.zeros((2, 8)), np.zeros((0, 9))):
        with pytest.raises(ValueError, match=r"values: got shape .* expected \(designs, 9 or 14\)"):
            Waves(values)
    with pytest.raises(ValueError, match="values: got NaN"):
        Waves(np.full((1, 9), np.nan))
    engine = TaskEngine("Walker-v0", BODIES[0], 3)
    with pytest.raises(ValueError, match="got 3 worlds, expected a multiple of 2"):
        Waves(np.zeros((2, 9)))(engine)
    with pytest.raises(ValueError, match="'reactive' setting, got 'invariant'"):
        Waves(np.zeros((1, 14)))(engine)
    engine.close()
    with pytest.raises(ValueError, match="env_steps: got 100, at least 1580 are needed"):
        search_gaits("Walker-v0", BODIES[0], GaitConfig(**vars(TINY) | {"env_steps": 100}))
    for name, value in {"early": 1.5, "sigma": 0, "candidates": 1, "first": 0, "seed": -1, "env_steps": 0}.items():
        with pytest.raises(ValueError, match=name):
            GaitConfig(**{name: value})
    with pytest.raises(ValueError, match="stiffness"):
        search_gaits("Walker-v0", BODIES[0], TINY, stiffness=[np.full((2, 3), 9.0)])


def test_voxels_may_have_a_phase_an_offset_and_a_level_of_their_own():
    engine = TaskEngine("Walker-v0", ["HHS/V.V"], 2, material="reactive")
    cells = np.zeros((1, 3, 2, 3))
    plain, same = Waves(np.zeros((1, 14)))(engine), Waves(np.zeros((1, 14)), cells)(engine)
    assert all(np.array_equal(*pair) for pair in zip(plain, same, strict=True))
    cells[0, 0, 0, 1], cells[0, 1, 1, 0], cells[0, 2, 0, 2] = 0.5, -0.5, 1.0
    actuation, stiffness = Waves(np.zeros((1, 14)), cells)(engine)
    assert actuation[1, 1] == pytest.approx(1.1 + 0.5 * min(1.5 * math.sin(1.0), 1.0), abs=1e-12)
    assert actuation[1, 3] == pytest.approx(1.1 - 0.5 * 0.3, abs=1e-12)
    assert actuation[1, 0] == plain[0][1, 0]
    assert stiffness[0, 2] == pytest.approx(2**0.6, abs=1e-12)
    assert stiffness[0, 1] == 1.0
    with pytest.raises(ValueError, match=r"grid of \(1, 6\)"):
        Waves(np.zeros((1, 14)), cells.reshape(1, 3, 1, 6))(engine)
    for wrong in (cells[:, :2], cells[0], np.full_like(cells, np.nan)):
        with pytest.raises(ValueError, match="cells: got"):
            Waves(np.zeros((1, 14)), wrong)
    engine.close()
