"""The experiments' program: its command line, its folders, runs that fail or are killed; tiny runs from end to end."""

import contextlib
import json
import pickle
import queue
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.experiments import workers
from benchmarks.experiments.options import EXPERIMENTS, SIZES, command_of, parse, parse_command
from benchmarks.experiments.program import main
from benchmarks.experiments.tuned import TUNED
from evogymcm import robots
from evogymcm.algos.runs import find_origin
from tests.registries import own_registries, shorten

PROGRAM = Path(__file__).resolve().parents[2] / "benchmarks" / "run_suite.py"


def program(*arguments):
    """What the program answers in a process of its own: its status, and what it writes."""
    command = [sys.executable, str(PROGRAM), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=PROGRAM.parents[1])
    return done.returncode, done.stdout, done.stderr


class OneThread(ThreadPoolExecutor):
    """Does one thing after another, and gives and takes what a process could be given and give."""

    def submit(self, fn, /, *args):
        return super().submit(lambda: pickled(fn(*pickled(args))))


def pickled(value):
    return pickle.loads(pickle.dumps(value))


@pytest.fixture
def program_here(monkeypatch, capsys):
    """Is called as `program`, and stays in this process."""

    @contextlib.contextmanager
    def thread(count):
        link = workers._Link(queue.Queue(), threading.Event())
        monkeypatch.setattr(workers, "_link", link)
        with OneThread(1) as pool:
            yield pool, link

    def call(*arguments):
        status = main([*map(str, arguments)])
        return status, *capsys.readouterr()

    monkeypatch.setattr(workers, "_workers", thread)
    with own_registries():
        yield call


def test_every_size_has_a_command_and_the_command_that_size():
    for name, (_, sizes) in EXPERIMENTS.items():
        assert tuple(sizes) == SIZES
        for size, experiment in sizes.items():
            options = parse([name, "--size", size])
            assert (options.name, options.size, options.experiment) == (name, size, experiment)
            assert parse_command(command_of(name, experiment)).experiment == experiment
    assert command_of("A", EXPERIMENTS["A"][1]["quick"]) == "python benchmarks/run_suite.py A"


def test_every_setting_can_be_given():
    c = EXPERIMENTS["C"][1]["small"]
    ppo = replace(c.codesign.ppo, decay_learning_rate=False, hidden=8, minibatch=5)
    changes = {"rungs": (0.25, 0.5), "keep": (0.5, 0.5), "inherit": True, "shape": (3, 4), "max_env_steps": None}
    other = replace(c, seeds=(7,), codesign=replace(c.codesign, **changes, ppo=ppo))
    command = command_of("C", other)
    assert "--seeds 7" in command
    assert "--codesign.ppo.no-decay-learning-rate" in command
    assert parse_command(command).experiment == other
    (job,) = parse(["A", "--arms", "co-optimisation", "--seeds", "3", "--ppo.total-steps", "500"]).experiment.jobs()
    assert (job.config.material, job.config.ppo.seed, job.config.ppo.total_steps) == ("reactive", 3, 500)
    assert parse(["C", "--codesign.search.rounds", "3", "--size=small"]).experiment.codesign.search.rounds == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "quick"], "--size"),
        (["A", "--tasks", "Hopper-v0"], "Hopper-v0"),
        (["A", "--arms", "fixed"], "fixed"),
        (["A", "--seeds"], "seeds"),
        (["A", "--ppo.seed", "1"], "ppo.seed"),
        (["B", "--codesign.seed", "1"], "codesign.seed"),
        (["C", "--arms", "control-only"], "control-only"),
        (["contexts", "--arms", "cnn"], "cnn"),
        (["universal", "--trained-on", "1"], "trained_on"),
        (["universal", "--arms", "shared"], "shared"),
        (["gaits", "--gait.seed", "1"], "gait.seed"),
        (["signals"], "folders"),
    ],
)
def test_bad_settings_are_told_before_there_is_a_folder(arguments, message, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        sys.exit(main([*arguments, "--output", str(tmp_path / "run")]))  # which the command line may do itself
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_an_existing_folder_is_refused(tmp_path, capsys):
    (tmp_path / "something").touch()
    assert main(["A", "--output", str(tmp_path)]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_tuned_settings_are_those_of_their_task_alone():
    plain, tuned = (parse(["A", "--size", "small", *flag]).experiment for flag in ([], ["--tuned"]))
    differing = {
        new.config.task: new.config.ppo for old, new in zip(plain.jobs(), tuned.jobs(), strict=True) if old != new
    }
    assert differing.keys() == TUNED.keys()
    assert all(getattr(differing[task], key) == value for task in TUNED for key, value in TUNED[task].ppo.items())
    assert all(of_task.evidence for of_task in TUNED.values())


def test_a_failed_run_does_not_take_the_others_with_it(tmp_path, monkeypatch, program_here):
    def run_job(job, folder, resume):
        if job.arm == "control-only":
            raise OSError("disk full")
        final = {"score": 9.0, "return": 10.0}
        return {
            "task": "Walker-v0", "label": job.arm, "seed": 0, "finished": True, "env_steps": 1000, "final": final,
            "curve": [(0, 0.1), (1000, 9.0)], "times": [1.0, 9.0], "origin": find_origin(),
        }  # fmt: skip

    monkeypatch.setattr(workers, "_run_job", run_job)
    status, out, err = program_here("A", "--output", tmp_path / "run")
    assert status == 1
    assert "disk full" in err
    assert "Walker-v0-control-only-seed0 failed" in err
    assert "--resume" in out
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert [run["label"] for run in results["runs"]] == ["co-optimisation"]
    assert not results["finished"]
    assert "Not finished." in (tmp_path / "run" / "table.md").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "n_runs", "env_steps"),
    [
        ("A --ppo.total-steps 300 --ppo.num-worlds 2", 2, 320),
        (
            "C --tasks Walker-v0 --arms fixed reactive invariant --codesign.population 3 --codesign.max-env-steps 2000"
            " --codesign.ppo.total-steps 256 --codesign.finetune-steps 256",
            3,
            None,
        ),
        ("contexts --arms attention mlp --ppo.total-steps 96 --ppo.num-worlds 1", 2, 96),
        ("gaits --short-steps 5000 --held-out 1 --gait.env-steps 6000 --gait.first 4 --gait.trial-steps 50", 3, None),
    ],
)
def test_a_tiny_experiment_from_end_to_end(arguments, n_runs, env_steps, tmp_path, program_here):
    arguments = [*arguments.split(), "--output", tmp_path / "run"]
    begin = program if arguments[0] == "A" else program_here  # processes are the same for all experiments
    if begin == program_here:
        shorten("Walker-v0", 60)
    status, out, err = begin(*arguments)
    assert status == 0, err
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["finished"]
    assert [run["finished"] for run in results["runs"]] == [True] * n_runs
    assert env_steps is None or {run["env_steps"] for run in results["runs"]} == {env_steps}
    assert (tmp_path / "run" / "table.md").read_text() in out
    assert parse_command(results["command"]).settings() == results["suite"]
    assert (tmp_path / "run" / "curves.png").exists()
    if arguments[0] == "contexts":
        return  # what follows is the same for all experiments
    assert program_here(*arguments)[0] == 2
    status, _, err = program_here(*arguments, "--resume")
    assert status == 0, err
    assert json.loads((tmp_path / "run" / "results.json").read_text())["summary"] == results["summary"]
    if arguments[0] == "A":
        _check_signals(tmp_path / "run", results["runs"], program_here)
    if arguments[0] == "C":
        assert [run["label"] for run in results["runs"] if "signals" in run] == ["reactive"]
        assert (tmp_path / "run" / "Walker-v0-reactive-seed0" / "signals.json").exists()
        for head in ("reactive minus fixed", "invariant minus fixed", "searched stiffness", "stiffness before impact"):
            assert head in out


def _check_signals(folder, runs, program_here):
    """Only the run with stiffness control has signals, of an episode that scores as the run's last policy."""
    control, run = runs
    assert "signals" not in control
    path = folder / "Walker-v0-co-optimisation-seed0" / "signals.json"
    assert not (folder / "Walker-v0-control-only-seed0" / "signals.json").exists()
    record = json.loads(path.read_text())
    assert record["score"] == pytest.approx(run["final"]["score"], abs=1e-4)
    assert run["signals"]["score"] == run["final"]["score"]
    assert len(record["voxels"]) == robots["Walk_Bot"].n_voxels
    assert {len(voxel["stiffness"]) for voxel in record["voxels"]} == {500}
    path.unlink()
    given = ["--folders", path.parent, "--output", folder.parent / "signals"]
    status, out, err = program_here("signals", *given)
    assert status == 0, err
    assert path.parent.name in out
    assert json.loads(path.read_text()) == record
    wrong = ["--folders", folder / "Walker-v0-control-only-seed0", folder, *given[2:], "--overwrite"]
    status, _, err = program_here("signals", *wrong)
    assert status == 1
    assert "invariant" in err
    assert "final.pt" in err


@pytest.mark.slow
def test_a_killed_experiment_leaves_no_worker_behind(tmp_path):
    command = [sys.executable, str(PROGRAM), "A", "--output", str(tmp_path / "run"), "--processes", "1"]
    suite = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    while suite.poll() is None and not list(tmp_path.glob("run/*/curve.jsonl")):
        time.sleep(0.1)
    suite.kill()
    suite.communicate(timeout=300)  # until no process holds its output any more
    (curve,) = tmp_path.glob("run/*/curve.jsonl")
    assert len(curve.read_text().splitlines()) < 200  # it had not come to its end
