"""Runs killed at ten random moments: they end with the files of a run that was left alone, bit for bit."""

import json
import signal
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from random import Random

import pytest
import torch

from evogymcm.algos import RunFolder, Trainer
from evogymcm.algos.codesign import codesign
from tests.algos.codesign.test_codesign import SEARCHING
from tests.algos.learning.test_real_env import TINY as TINY_TRAINING
from tests.algos.learning.test_real_env import make_short

FORKS = get_context("forkserver")
FORKS.set_forkserver_preload([__name__])  # torch is loaded once for all processes
KILLS = 10
CODESIGN = replace(SEARCHING, budget=9, inherit=True, mutants=3)


def train_in(folder, progress=None):
    Trainer(make_short, TINY_TRAINING).train(
        run=RunFolder(folder, asdict(TINY_TRAINING), resume=True), progress=progress
    )


def codesign_in(folder, progress=None):
    codesign(CODESIGN, run=RunFolder(folder, asdict(CODESIGN), resume=True), progress=progress)


def tell(work, folder, news):
    """What a process does: `work`, and it sends a word before it and after each update."""
    news.send("")
    work(folder, lambda progress: news.send(""))


def bits(value):
    """A saved state as something that compares bit for bit, NaN included; without the time that it took."""
    if isinstance(value, torch.Tensor):
        return value.dtype, tuple(value.shape), value.contiguous().numpy().tobytes()
    if isinstance(value, Mapping):
        return {key: bits(item) for key, item in value.items() if key != "seconds"}
    if isinstance(value, list | tuple):
        return [bits(item) for item in value]
    return value


def files(folder):
    """All that a run leaves behind: checkpoints and policies, and every table."""
    folder = Path(folder)
    states = {path.name: bits(torch.load(path, weights_only=True)) for path in folder.glob("*.pt")}
    tables = {
        str(path.relative_to(folder)): [bits(json.loads(line)) for line in path.read_text().splitlines()]
        for path in folder.rglob("curve.jsonl")
    }
    return states | tables


def killed_ten_times(work, folder, pause):
    """Runs `work` in processes that are killed, and again to its end; returns its folders and what each kill left.

    A process is killed some updates after its start, and then up to `pause` seconds later, within the next ones.
    """
    rng, left, number = Random(0), [], 0
    while len(left) < KILLS:
        here = folder / str(number)
        receiver, news = FORKS.Pipe(duplex=False)
        process = FORKS.Process(target=tell, args=(work, str(here), news))
        process.start()
        news.close()
        with receiver:
            with suppress(EOFError):  # where it has come to its end
                for _ in range(1 + rng.randrange(7)):
                    receiver.recv()
                time.sleep(rng.uniform(0.0, pause))
            process.kill()  # nothing where it has ended
            process.join()
        code = process.exitcode
        assert code in (0, -signal.SIGKILL)
        if code == 0:
            number += 1  # the next kills meet a new run
        else:
            left.append({path.name for path in here.glob("*.pt")})
    folders = [folder / str(i) for i in range(number + 1)]
    for here in folders:
        work(here)
    return folders, left


@pytest.mark.slow
@pytest.mark.parametrize(("work", "state"), [(train_in, "checkpoint.pt"), (codesign_in, "codesign.pt")])
def test_a_killed_run_ends_with_the_same_files(work, state, tmp_path):
    times = []
    work(tmp_path / "whole", lambda progress: times.append(time.monotonic()))
    whole = files(tmp_path / "whole")
    assert {state, "curve.jsonl"} <= whole.keys()
    folders, left = killed_ten_times(work, tmp_path, pause=2 * (times[-1] - times[0]) / len(times))
    assert any(state in names for names in left)  # some went on from the middle
    for folder in folders:
        ours = files(folder)
        assert ours.keys() == whole.keys()
        for name, content in whole.items():
            assert ours[name] == content, name


def test_a_run_killed_before_its_first_checkpoint_begins_anew(tmp_path):
    config = replace(TINY_TRAINING, total_steps=256, eval_interval=0)
    RunFolder(tmp_path / "run", asdict(config)).append({"env_steps": 0})
    run = RunFolder(tmp_path / "run", asdict(config), resume=True)
    result = Trainer(make_short, config).train(run=run)
    assert run.rows() == json.loads(json.dumps(result.rows))


def test_a_run_killed_before_its_settings_were_written_begins_anew(tmp_path):
    (tmp_path / ".config.json.part").write_text("{")
    assert RunFolder(tmp_path, {"seed": 1}, resume=True).read_json("config.json") == {"seed": 1}


def test_one_bit_is_noticed():
    state = {"weights": [torch.tensor([1.0, float("nan")])], "seconds": 3.0}
    assert bits(state) == bits({"weights": [torch.tensor([1.0, float("nan")])], "seconds": 4.0})
    assert bits(state) != bits({"weights": [torch.tensor([1.0 + 2**-23, float("nan")])], "seconds": 3.0})
