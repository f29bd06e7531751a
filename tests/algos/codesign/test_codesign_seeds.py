"""Generations and seeds of co-design: one count, and draws that no two places share."""

import json
from dataclasses import replace
from itertools import product

import pytest

from evogymcm.algos import RunFolder
from evogymcm.algos.codesign import codesign
from evogymcm.algos.codesign.plan import derived_seed, generations
from tests.algos.codesign.test_codesign_methods import QUICK

HALVED = replace(QUICK, budget=6, rungs=(0.5,), keep=(0.5,))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Runs of seeds 0 and 1000: their folders, tables, and what they told of their progress."""
    found = {}
    for seed in (0, 1000):
        path, told = tmp_path_factory.mktemp("runs") / str(seed), []
        config = replace(HALVED, seed=seed)
        result = codesign(config, run=RunFolder(path, {}), progress=told.append)
        found[seed] = (path, result.rows, told)
    return found


def test_there_is_one_count_of_generations(runs):
    path, rows, told = runs[0]
    count = len(list(generations(HALVED)))
    assert count == 2
    phases = set(product(range(count), ("train", "search", "finetune")))
    assert {(progress.generation, progress.phase) for progress in told} == phases
    assert {(row["generation_now"], row["event"]) for row in rows} == phases
    assert {row["generation"] for row in rows} == set(range(count))
    parts = product(range(count), ("finetune", "train-0", "train-1"))
    folders = {f"generation-{generation:03}/{part}" for generation, part in parts}
    assert {str(table.parents[1].relative_to(path)) for table in path.glob("*/*/*/curve.jsonl")} == folders
    for folder in folders:
        for number, piece in enumerate(sorted((path / folder).iterdir())):
            own = json.loads((piece / "config.json").read_text())
            assert folder == f"generation-{own['generation']:03}/{own['phase']}"
            assert piece.name == f"piece-{number:03}"


def test_no_two_trainings_have_the_same_seed(runs):
    configs = [json.loads(file.read_text()) for path, _, _ in runs.values() for file in path.glob("*/*/*/config.json")]
    assert len({config["seed"] for config in configs}) == len(configs) >= 2 * 2 * 3  # runs, generations, parts


def test_seeds_are_those_of_seed_sequences():
    places = product((0, 1, 1000, 1001, 2**32), range(3), range(3), range(3))
    seeds = [derived_seed(*place) for place in places]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert derived_seed(0, 1, 2) == derived_seed(0, 1, 2) != derived_seed(0, 1)
