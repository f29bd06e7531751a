"""Settings: whatever cannot work is refused where they are made, or before a run begins."""

import json
import sys
from concurrent.futures import Executor
from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from evogymcm.algos import BodyPPOConfig, PPOConfig, RunFolder
from evogymcm.algos.codesign import (
    CodesignConfig,
    GeneticAlgorithm,
    SearchConfig,
    codesign,
    codesign_all,
    cost_of,
)

CONFIGS = (PPOConfig(), BodyPPOConfig(), SearchConfig(), CodesignConfig())
TEXTS = {
    "selection",
    "network",
    "context",
    "sharing",
    "acceptance",
    "noise",
    "proposal",
    "task",
    "material",
    "method",
    "edge_rule",
}
FLAGS = {"decay_learning_rate", "inherit"}
GROUPS = {"schedule", "shape", "weights", "rungs", "keep", "search", "ppo"}
OPTIONAL = {
    "hidden",
    "eval_worlds",
    "search",
    "max_env_steps",
    "inherit_std",
    "finetune_steps",
    "num_threads",
    "piece",
    "work_weight",
}


@pytest.mark.parametrize("config", CONFIGS, ids=lambda config: type(config).__name__)
def test_every_field_refuses_what_is_of_another_kind(config):
    wrong = {"text": "x", "none": None, "object": object(), "nan": np.nan, "list": [1.0, 2.0, 3.0]}
    for field in fields(config):
        name = field.name
        kinds = set(wrong)
        if name in OPTIONAL:
            kinds -= {"none"}
        if name in ("task", "initial"):
            kinds -= {"text"}  # whether there is such a task or policy is checked when a run starts
        for kind in sorted(kinds):
            with pytest.raises(ValueError, match=rf"^{name}: got |^{name}: "):
                replace(config, **{name: wrong[kind]})
        if name not in TEXTS | FLAGS | GROUPS:
            for value in (-1, True, np.inf, [3]):
                with pytest.raises(ValueError, match=f"^{name}: got "):
                    replace(config, **{name: value})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shape": (5, 5, 5)}, "shape: got"),
        ({"shape": (0, 5)}, "shape: got 0, expected a whole number of at least 1"),
        ({"shape": (2.5, 2)}, "shape: got 2.5"),
        ({"shape": (1, 1)}, r"budget: got 32, there are at most 2 bodies of shape \(1, 1\)"),
        ({"population": 2.5}, "population: got 2.5"),
        ({"population": 33}, "population: got 33, expected 1 to 32"),
        ({"population": 2}, "population: got 2, expected at least 3"),
        ({"mutation_rate": 0.0}, "mutation_rate: got 0.0, expected a finite number above 0 and at most 1"),
        ({"mutation_rate": 1.5}, "mutation_rate: got 1.5"),
        ({"weights": (1, 1, 1, 0, 0)}, "weights: got"),
        ({"rungs": (0.5, 0.25), "keep": (0.5, 0.5)}, "rungs: got"),
        ({"rungs": (0.5,), "keep": (0.0,)}, "keep: got"),
        ({"rungs": 0.5, "keep": 0.5}, "rungs: got 0.5, expected a sequence of numbers"),
        ({"stiffness": 0.4}, "stiffness: got 0.4, expected a finite number at least 0.5 and at most 2"),
        ({"stiffness": 1.5}, "stiffness: got 1.5, policies set stiffness; needs material 'invariant'"),
        ({"search": SearchConfig()}, "search: got SearchConfig.*, policies set stiffness; needs material 'invariant'"),
        ({"material": "invariant", "search": SearchConfig(), "stiffness": 1.5}, "stiffness: got 1.5, a search begins"),
        ({"material": "active"}, "material: got 'active', allowed are invariant, reactive"),
        ({"method": "bo"}, "method: got 'bo', allowed are ga, random, qd"),
        ({"rungs": (0.5,), "keep": ()}, "keep: got"),
        ({"max_env_steps": 0}, "max_env_steps: got 0"),
        ({"ppo": BodyPPOConfig(network="mlp")}, "ppo.network: got 'mlp'"),
        ({"edge_rule": "mean"}, "edge_rule: got 'mean', allowed are mean_factor, mean_stiffness"),
        ({"age_protection": 1, "method": "random"}, "age_protection: got 1, method 'random' has none"),
        ({"ppo": PPOConfig(total_steps=50_000)}, "ppo: got a PPOConfig, expected a BodyPPOConfig"),
        ({"ppo": BodyPPOConfig(seed=3)}, "ppo.seed: got 3, in co-design it comes from seed"),
        (
            {"ppo": BodyPPOConfig(schedule=(0.5, 1))},
            r"ppo.schedule: got \(0.5, 1.0\), in co-design it",
        ),
    ],
)
def test_bad_settings_of_codesign_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        CodesignConfig(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"noise": "pink"}, "noise: got 'pink', allowed are multiplicative, additive"),
        ({"acceptance": "any"}, "acceptance: got 'any', allowed are reference, paper"),
        ({"proposal": "random"}, "proposal: got 'random', allowed are hill-climbing, cma"),
        ({"proposal": "cma", "candidates": 1}, "candidates: got 1, proposal 'cma' needs at least 2"),
        ({"rounds": 0}, "rounds: got 0"),
        ({"probability": 1.1}, "probability: got 1.1"),
        ({"sigma": 0}, "sigma: got 0"),
    ],
)
def test_bad_settings_of_the_material_search_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        SearchConfig(**changes)


def test_missing_packages_are_named_before_any_work(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "cma", None)
    monkeypatch.setitem(sys.modules, "ribs.archives", None)
    search = SearchConfig(proposal="cma", candidates=4)
    for config in (CodesignConfig(material="invariant", search=search), CodesignConfig(method="qd")):
        with pytest.raises(ImportError, match=r"evogymcm\[(cma|qd)\]"):
            codesign(config)
        with pytest.raises(ImportError, match=r"evogymcm\[(cma|qd)\]"):
            list(codesign_all({"one": config}, tmp_path, Untouched()))


def test_arms_are_still_taken_with_a_word_on_what_to_write():
    search = SearchConfig(rounds=3)
    for old, new in (
        ({"arm": "reactive", "search": search}, CodesignConfig()),
        ({"arm": "fixed", "prescribed": 1.5}, CodesignConfig(material="invariant")),
        ({"arm": "prescribed", "prescribed": 1.5}, CodesignConfig(material="invariant", stiffness=1.5)),
        ({"arm": "invariant"}, CodesignConfig(material="invariant", search=SearchConfig())),
        ({"arm": "invariant", "search": search}, CodesignConfig(material="invariant", search=search)),
    ):
        said = f"arm='{old['arm']}' .* write material='{new.material}', stiffness="
        with pytest.warns(DeprecationWarning, match=said):
            assert CodesignConfig(**old) == new
        with pytest.warns(DeprecationWarning, match=said):
            assert replace(new, **old) == new
    with pytest.raises(ValueError, match="arm: got 'active', allowed are reactive"):
        CodesignConfig(arm="active")


def test_numbers_of_numpy_are_taken_and_saved(tmp_path):
    ppo = BodyPPOConfig(total_steps=1e6, num_worlds=np.int64(4), gamma=np.float32(0.5), decay_learning_rate=np.True_)
    config = CodesignConfig(shape=np.array([3, 4]), seed=np.int64(7), rungs=[np.float64(0.5)], keep=[1], ppo=ppo)
    plain = BodyPPOConfig(total_steps=1_000_000, num_worlds=4, gamma=0.5)
    assert config == CodesignConfig(shape=(3, 4), seed=7, rungs=(0.5,), keep=(1.0,), ppo=plain)
    RunFolder(tmp_path / "run", asdict(config))
    saved = json.loads((tmp_path / "run" / "config.json").read_text())
    assert (saved["shape"], saved["seed"], saved["ppo"]["total_steps"]) == ([3, 4], 7, 1_000_000)
    assert type(GeneticAlgorithm((2, 3), 6, np.int64(3), seed=np.int64(1)).settings["population"]) is int


class Untouched(Executor):
    """Nothing may be submitted."""

    def submit(self, fn, /, *args, **kwargs):
        raise AssertionError("a run was started")


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"task": "Nope-v0"}, "task: got 'Nope-v0'"), ({"task": "Climber-v0", "shape": (5, 9)}, "does not fit")],
)
def test_a_run_that_cannot_start_is_refused_before_any_work(changes, message, tmp_path):
    config = CodesignConfig(**changes)
    run = RunFolder(tmp_path / "run", asdict(config))
    fresh = set(run.path.iterdir())
    with pytest.raises(ValueError, match=message):
        codesign(config, run=run)
    assert set(run.path.iterdir()) == fresh
    with pytest.raises(ValueError, match=f"bad: .*{message}"):
        list(codesign_all({"good": CodesignConfig(), "bad": config}, tmp_path, Untouched()))
    with pytest.raises(ValueError, match="executor: got 4, expected a concurrent"):
        list(codesign_all({"good": CodesignConfig()}, tmp_path, 4))
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    if "task" in message:
        with pytest.raises(ValueError, match=message):
            cost_of(config)
