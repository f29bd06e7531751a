"""Signals of an episode: known frequencies, lags and rises are found; contact is that of the simulator."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import evogymcm as cm
from evogymcm.algos import evaluate, make_actor
from evogymcm.algos.analysis import GroundContact, Recording, analyse_signals, anticipation, record_episode
from evogymcm.algos.analysis.signals import STEP_SECONDS
from evogymcm.envs import SoftRobotEnv, TaskEngine
from evogymcm.sim.world import World

STEPS = 500


def _recording(actuation=None, stiffness=None, contact=None) -> Recording:
    """One actuator (first column) and one soft voxel; what is not given does not vary."""
    steps = len(next(series for series in (actuation, stiffness, contact) if series is not None))
    both = np.ones((steps, 2))
    touches = np.zeros((steps, 2), bool)
    if stiffness is not None:
        both[:, 0] = stiffness
    if contact is not None:
        touches[:, 0] = contact
    target = np.ones(steps) if actuation is None else actuation
    return Recording(
        "Walker-v0", np.array([[0, 3], [1, 2]]), np.array([True, False]),
        np.stack([target, np.full(steps, np.nan)], 1), both, touches, 1.0,
    )  # fmt: skip


def _wave(period: float, shift: float, *, steps: int = STEPS, noise: float = 0.0) -> np.ndarray:
    """A sine that follows the one of shift 0 by `shift` steps."""
    rough = np.random.default_rng(abs(int(100 * shift)) + 1).normal(size=steps)
    return 1.1 + 0.3 * np.sin(2 * np.pi * (np.arange(steps) - shift) / period) + noise * rough


@pytest.mark.parametrize(("period", "shift"), [(16, 3), (16, -5), (25.3, 7), (11.7, 0), (40, 12)])
def test_frequency_lag_and_phase_of_shifted_sines(period, shift):
    voxel = analyse_signals(_recording(_wave(period, 0, noise=0.02), _wave(period, shift, noise=0.02))).voxels[0]
    expected = 1 / (period * STEP_SECONDS)
    assert voxel.frequency_actuation == pytest.approx(expected, rel=0.03)
    assert voxel.frequency_stiffness == pytest.approx(expected, rel=0.03)
    assert voxel.lag_steps == shift
    assert voxel.phase_lag == pytest.approx(2 * np.pi * shift / period, abs=0.08)
    assert voxel.correlation > 0.97
    assert voxel.coherence > 0.97


def test_half_a_period_is_the_opposite_phase():
    voxel = analyse_signals(_recording(_wave(20, 0), _wave(20, 10))).voxels[0]
    assert abs(voxel.phase_lag) == pytest.approx(np.pi, abs=0.02)
    assert abs(voxel.lag_steps) == 10


def test_a_lag_that_wanders_has_little_coherence():
    """Phases of the stiffness are drawn anew in every 64 env-steps, the actuation goes on."""
    shifts = np.repeat(np.random.default_rng(5).uniform(0, 16, 8), 64)[:STEPS]
    stiffness = 1.1 + 0.3 * np.sin(2 * np.pi * (np.arange(STEPS) - shifts) / 16)
    voxel = analyse_signals(_recording(_wave(16, 0), stiffness)).voxels[0]
    assert voxel.coherence < 0.5


def test_noise_shares_no_frequency_with_a_gait():
    rng = np.random.default_rng(3)
    shares = [
        analyse_signals(_recording(_wave(16, 0), 1 + 0.2 * rng.normal(size=STEPS))).summary()["same_frequency"]
        for _ in range(20)
    ]
    assert np.mean(shares) < 0.3


def test_the_spectrum_integrates_to_the_variance():
    actuation = _wave(16, 0)
    spectra = analyse_signals(_recording(actuation, _wave(8, 0))).spectra
    assert spectra.frequency[spectra.actuation.argmax()] == pytest.approx(1 / (16 * STEP_SECONDS), rel=0.02)
    assert spectra.frequency[spectra.stiffness.argmax()] == pytest.approx(1 / (8 * STEP_SECONDS), rel=0.02)
    assert spectra.actuation.sum() * spectra.frequency[1] == pytest.approx(actuation.var(), rel=0.03)


def test_signals_that_do_not_vary_have_no_frequency():
    voxel, soft = analyse_signals(_recording(_wave(16, 0), np.full(STEPS, 0.7))).voxels
    assert voxel.frequency_actuation is not None
    assert (voxel.frequency_stiffness, voxel.phase_lag, voxel.lag_steps, voxel.correlation) == (None,) * 4
    assert (soft.actuation, soft.frequency_actuation, soft.is_actuator) == (None, None, False)


def _landings(at: np.ndarray, rise: float, *, noise: float = 0.0) -> Recording:
    """Contact for six env-steps from each landing; stiffness is larger by `rise` in it and in the three before."""
    contact, stiffness = np.zeros(STEPS, bool), np.ones(STEPS)
    stiffness += noise * np.random.default_rng(2).normal(size=STEPS)
    for t in at:
        contact[t : t + 6] = True
        stiffness[t - 3 : t + 1] += rise
    return _recording(stiffness=stiffness, contact=contact)


@pytest.mark.parametrize("rise", [0.4, -0.4])
def test_a_rise_before_impact_is_measured(rise):
    landings = np.arange(30, 470, 22)
    down = analyse_signals(_landings(landings, rise, noise=0.1)).contact
    assert down.n_impacts == len(landings)
    assert down.rise_before_impact == pytest.approx(rise, abs=0.06)
    low, high = down.rise_interval
    assert low < down.rise_before_impact < high
    assert (low > 0) == (rise > 0)
    assert down.stiffness[np.isin(down.lags, [-3, -2, -1, 0])] == pytest.approx(1 + rise, abs=0.1)
    assert down.stiffness[down.lags > 0] == pytest.approx(1, abs=0.1)
    assert down.rise_rank > 0.95 if rise > 0 else down.rise_rank < 0.05


@pytest.mark.parametrize(
    ("landings", "rise", "noise", "sign"),
    [(20, 0.4, 0.1, 1), (20, -0.4, 0.1, -1), (20, 0.0, 0.1, 0), (20, 0.0005, 0.0, 0), (9, 0.4, 0.1, None)],
)
def test_anticipation_is_a_rise_whose_interval_is_above_zero(landings, rise, noise, sign):
    recording = _landings(np.arange(30, 470, 22)[:landings], rise, noise=noise)
    assert anticipation(analyse_signals(recording).summary()) == sign


def test_a_rise_after_impact_is_none_before():
    """Stiffness that answers to the contact must not look as if it foresaw it."""
    contact, stiffness = np.zeros(STEPS, bool), np.ones(STEPS)
    for t in range(30, 470, 22):
        contact[t : t + 6] = True
        stiffness[t + 1 : t + 6] += 0.5
    down = analyse_signals(_recording(stiffness=stiffness, contact=contact)).contact
    assert down.rise_before_impact == 0.0
    assert down.stiffness[down.lags == 0] == 1.0
    assert down.stiffness[down.lags == 1] == 1.5


@pytest.mark.slow
def test_intervals_hold_the_true_rise_about_as_often_as_they_say():
    rng, truth, held = np.random.default_rng(11), 0.1, 0
    for _ in range(150):
        contact, stiffness = np.zeros(STEPS, bool), 1 + 0.2 * rng.normal(size=STEPS)
        for t in range(30, 470, 22):
            contact[t : t + 6] = True
            stiffness[t - 1 : t + 1] += truth
        low, high = analyse_signals(_recording(stiffness=stiffness, contact=contact)).contact.rise_interval
        held += low <= truth <= high
    assert 0.87 <= held / 150 <= 0.99  # 20 impacts: a percentile bootstrap is a little narrow


def test_what_counts_as_an_impact():
    contact = np.zeros(100, bool)
    contact[5] = True  # too early: lag -10 is before the episode
    contact[[20, 21, 22]] = True
    contact[25] = True  # after two env-steps without contact
    contact[29] = True  # after three
    contact[95] = True  # too late
    down = analyse_signals(_recording(stiffness=np.linspace(0.5, 2, 100), contact=contact)).contact
    assert down.n_impacts == 2
    # Landings at 20 and 29; an even rise of 1.5 / 99 a step over 7.5 steps.
    assert down.rise_before_impact == pytest.approx(7.5 * 1.5 / 99)
    assert down.stiffness[down.lags == 0] == pytest.approx(0.5 + 24.5 * 1.5 / 99)


@pytest.mark.parametrize("steps", [1, 2, 5, 20, 40])
def test_short_episodes_tell_nothing_instead_of_failing(steps):
    signals = analyse_signals(_recording(_wave(8, 0, steps=steps), _wave(8, 2, steps=steps), np.ones(steps, bool)))
    assert signals.contact.n_impacts == 0
    assert signals.contact.rise_before_impact is None
    assert (signals.voxels[0].frequency_actuation is None) == (steps < 16)
    json.dumps(signals.record(), allow_nan=False)


def test_the_record_is_json_of_the_agreed_form():
    record = json.loads(json.dumps(analyse_signals(_landings(np.arange(30, 470, 22), 0.2)).record(), allow_nan=False))
    assert {"task", "voxels", "step_seconds", "spectra", "contact", "summary"} <= record.keys()
    assert record["step_seconds"] == pytest.approx(0.003)
    voxel, soft = record["voxels"]
    assert (voxel["row"], voxel["column"], voxel["is_actuator"]) == (0, 3, True)
    assert len(voxel["actuation"]) == len(voxel["stiffness"]) == STEPS
    assert set(voxel["contact"]) == {0, 1}
    assert soft["actuation"] is None
    assert {"frequency_actuation", "frequency_stiffness", "phase_lag", "lag_steps", "correlation"} <= voxel.keys()
    assert record["spectra"].keys() == {"frequency", "actuation", "stiffness"}
    assert record["contact"]["lags"] == list(range(-10, 11))
    assert {"stiffness", "n_impacts", "rise_before_impact", "rise_interval"} <= record["contact"].keys()


def test_series_must_fit_together():
    with pytest.raises(ValueError, match="contact"):
        replace(_recording(_wave(16, 0)), contact=np.zeros((3, 2), bool))


# In the simulator.

make = functools.partial(SoftRobotEnv, material="reactive", num_threads=1)


@pytest.mark.slow
def test_an_episode_of_the_simulator_is_recorded():
    env = make("Walker-v0", bodies="Walk_Bot", num_worlds=1)
    torch.manual_seed(0)
    actor = make_actor(env)
    with torch.no_grad():
        for parameter in actor.parameters():  # an untrained policy hardly moves
            parameter.mul_(3.0)
    recording = record_episode(actor, env)
    body = cm.robots["Walk_Bot"]
    assert recording.stiffness.shape == (500, body.n_voxels)
    assert recording.is_actuator.sum() == body.n_actuators
    assert np.isfinite(recording.actuation[:, recording.is_actuator]).all()
    assert np.isnan(recording.actuation[:, ~recording.is_actuator]).all()
    assert recording.stiffness.min() >= 0.5
    assert recording.stiffness.max() <= 2.0
    assert recording.score == evaluate(actor, make("Walker-v0", bodies="Walk_Bot", num_worlds=1)).score[0]
    legs = recording.cells[recording.contact.any(0)].tolist()
    assert {tuple(cell) for cell in legs} >= {(3, 0), (3, 4)}
    assert all(row >= 2 for row, _ in legs)  # Walk_Bot never lies on its back
    again = record_episode(actor, env)
    np.testing.assert_array_equal(recording.stiffness, again.stiffness)
    json.dumps(analyse_signals(recording).record(), allow_nan=False)


def test_only_one_reactive_world_can_be_recorded():
    env = make("Walker-v0", bodies="Walk_Bot", num_worlds=2)
    with pytest.raises(ValueError, match="2 worlds"):
        record_episode(make_actor(env), env)
    env = SoftRobotEnv("Walker-v0", bodies="Walk_Bot", num_worlds=1, material="invariant", num_threads=1)
    with pytest.raises(ValueError, match="reactive"):
        record_episode(make_actor(env), env)


@pytest.mark.parametrize("task", ["Walker-v0", "BridgeWalker-v0", "DownStepper-v0", "AreaMaximizer-v0"])
def test_a_robot_at_rest_stands_on_its_lowest_voxels(task):
    engine = TaskEngine(task, ["HSH/H.H"], material="reactive", num_threads=1)
    ground, ones = GroundContact(engine), np.ones((1, 6))
    for _ in range(60):
        engine.step(ones, ones)
    assert ground.cells[ground.now()].tolist() == [[1, 0], [1, 2]]


def test_contact_ends_where_the_robot_is_lifted():
    engine = TaskEngine("Walker-v0", ["HSH/H.H"], material="reactive", num_threads=1)
    ground, ones = GroundContact(engine), np.ones((1, 6))
    for _ in range(60):
        engine.step(ones, ones)
    engine.simulator.move("robot", (0.0, 0.01), 0)
    assert not ground.now().any()
    engine.simulator.move("robot", (0.0, -0.01), 0)
    assert ground.now().sum() == 2


def test_a_step_under_a_voxels_middle_is_contact():
    """Between its own corners, the voxel stands on a corner of the ground."""
    world = World.from_picture("object ground at 0 0\n..F..\nFFFFF\nobject far at 9 0\nF")
    task = replace(cm.tasks["Walker-v0"], world=world, spawn=(1, 2))
    engine = TaskEngine(task, ["RRH"], material="reactive", num_threads=1)
    ground = GroundContact(engine)
    engine.simulator.move("robot", (0.05, 0.001), 0)
    assert ground.cells[ground.now()].tolist() == [[0, 0], [0, 1]]


def test_walls_are_no_ground():
    world = World.from_picture("F...\nF...\nFFFF")
    task = replace(cm.tasks["Walker-v0"], world=world, spawn=(1, 1))
    engine = TaskEngine(task, ["H/R"], material="reactive", num_threads=1)
    engine.simulator.move("robot", (-0.001, 0.02), 0)
    assert not GroundContact(engine).now().any()
