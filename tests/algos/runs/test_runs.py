"""Run folders: refusal, overwriting, resuming, atomic files; stopping on Ctrl-C."""

import errno
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch

from evogymcm._files import write_atomic
from evogymcm.algos import RunFolder, RunInUseError, Trainer, stop_on_interrupt
from tests.algos.learning.test_training import TINY
from tests.algos.toy_env import ToyEnv

ROOT = Path(__file__).parents[3]
CONFIG = {"seed": 1, "tasks": ("a", "b")}
AT_WORK = """
import sys, time
from evogymcm.algos.runs import RunFolder
with RunFolder(sys.argv[1], {}).lock():
    print("at work", flush=True)
    time.sleep(600)
"""


def test_an_existing_run_is_refused_unless_told_otherwise(tmp_path):
    run = RunFolder(tmp_path / "run", CONFIG)
    run.append({"env_steps": 0})
    with pytest.raises(FileExistsError, match="overwrite"):
        RunFolder(tmp_path / "run", CONFIG)
    assert RunFolder(tmp_path / "run", CONFIG, resume=True).rows() == [{"env_steps": 0}]
    assert RunFolder(tmp_path / "run", CONFIG, overwrite=True).rows() == []


def test_resuming_with_other_settings_is_refused(tmp_path):
    RunFolder(tmp_path, CONFIG)
    with pytest.raises(ValueError, match="seed: got 2, the run has 1"):
        RunFolder(tmp_path, {**CONFIG, "seed": 2}, resume=True)
    with pytest.raises(ValueError, match="only one"):
        RunFolder(tmp_path, CONFIG, resume=True, overwrite=True)


def test_a_folder_of_something_else_is_never_deleted(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(FileExistsError, match="not a run folder"):
        RunFolder(tmp_path, CONFIG, overwrite=True)
    assert (tmp_path / "thesis.tex").exists()


def test_resuming_a_run_that_never_began_starts_it(tmp_path):
    assert RunFolder(tmp_path / "new", CONFIG, resume=True).read_json("config.json") == {"seed": 1, "tasks": ["a", "b"]}


def test_one_process_at_a_time_works_on_a_run_and_a_killed_one_leaves_no_lock(tmp_path):
    command = [sys.executable, "-c", AT_WORK, str(tmp_path / "run")]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "at work\n"
        run = RunFolder(tmp_path / "run", {}, resume=True)
        run.append({"env_steps": 0, "score": 0.0})
        with pytest.raises(RunInUseError, match=r"run is in use: another process"):
            Trainer(ToyEnv, TINY).train(run=run)
        with pytest.raises(RunInUseError):
            RunFolder(tmp_path / "run", {}, overwrite=True)
        assert run.rows() == [{"env_steps": 0, "score": 0.0}]  # to be read, and as it was
        assert run.load("checkpoint") is None
        process.kill()
    assert Trainer(ToyEnv, TINY).train(run=run).finished
    assert len(run.rows()) == 7


def test_threads_of_a_process_keep_each_other_out_too_and_a_failure_ends_it(tmp_path):
    run = RunFolder(tmp_path, CONFIG)

    def work():
        with RunFolder(tmp_path, CONFIG, resume=True).lock():
            raise ZeroDivisionError

    with ThreadPoolExecutor(1) as pool:
        with run.lock(), pytest.raises(RunInUseError):
            pool.submit(work).result()
        for _ in range(2):
            with pytest.raises(ZeroDivisionError):
                pool.submit(work).result()
    with run.lock():
        assert RunFolder(tmp_path, CONFIG, resume=True).read_json("config.json")["seed"] == 1


def test_a_file_system_without_locks_is_told_of(tmp_path, monkeypatch):
    def acquire(self, timeout):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("filelock.FileLock.acquire", acquire)
    with pytest.warns(UserWarning, match="knows no locks"):
        run = RunFolder(tmp_path, CONFIG)
    assert run.read_json("config.json")["seed"] == 1


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "state.json"
    path.write_text("old")

    def fail(part):
        part.write_text("half of the ne")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomic(path, fail)
    assert path.read_text() == "old"
    write_atomic(path, lambda part: part.write_text("new"))
    assert path.read_text() == "new"


def test_table_survives_a_row_cut_short(tmp_path):
    run = RunFolder(tmp_path, CONFIG)
    for step in range(4):
        run.append({"env_steps": step, "score": float("nan")})
    with (tmp_path / "curve.jsonl").open("a") as file:
        file.write('{"env_steps": 4, "sc')
    assert [row["env_steps"] for row in run.rows()] == [0, 1, 2, 3]
    assert run.rows()[0]["score"] is None  # JSON has no NaN
    run.keep_rows(2)
    run.append({"env_steps": 9})
    assert [row["env_steps"] for row in run.rows()] == [0, 1, 9]


def test_checkpoints_come_back_as_they_were(tmp_path):
    run = RunFolder(tmp_path, CONFIG)
    assert run.load("checkpoint") is None
    state = {"net": {"w": torch.arange(3.0)}, "steps": 7, "big": 2**100, "rows": [1, 2]}
    run.save("checkpoint", state)
    loaded = run.load("checkpoint")
    torch.testing.assert_close(loaded.pop("net")["w"], state.pop("net")["w"])
    assert loaded == state
    assert not list(tmp_path.glob(".*.part"))


def test_the_first_interrupt_sets_a_flag_and_the_second_interrupts(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    with stop_on_interrupt() as is_stopped:
        assert not is_stopped()
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)  # at once: the same press, passed on by a launcher
        assert is_stopped()
        monkeypatch.setattr("evogymcm.algos.runs.folder._SAME_PRESS", 0.0)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
