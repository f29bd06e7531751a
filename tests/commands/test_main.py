"""The command line as a whole: help, errors, what it loads, completion."""

import contextlib
import io
import shutil
import subprocess
import sys

import pytest

from evogymcm import robot_tasks, tasks
from evogymcm.__main__ import COMMANDS, main
from evogymcm.algos.learning.bodies import STANDARD_BODY
from evogymcm.envs import TaskEngine
from tests.commands.tools import refused


def shown(capsys, *arguments):
    """What a command prints that must succeed and ends by itself."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    assert not stop.value.code
    return capsys.readouterr().out


def test_help_names_all_commands_and_shows_examples(capsys):
    text = shown(capsys, "--help")
    assert all(f"• {name} " in text for name in COMMANDS)
    assert "evogymcm train Walker-v0 --body Walk_Bot --run runs/first" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_shows_examples(capsys, command):
    text = shown(capsys, command, "--help")
    assert f"usage: evogymcm {command}" in text
    assert f"examples:\n  evogymcm {command}" in text


def test_options_are_those_of_the_settings(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    train, codesign = shown(capsys, "train", "--help"), shown(capsys, "codesign", "--help")
    assert "--noise-correlation" in train
    assert "env-steps of all worlds together" in train  # what PPOConfig says of its fields
    assert "--ppo.noise-correlation" in codesign
    assert "probability that a cell of a child is drawn anew" in codesign


LOADED = """
import contextlib, io, sys
from evogymcm.__main__ import COMMANDS, main

for command in ([], *([name] for name in COMMANDS)):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main([*command, "--help"])
    loaded = {"tyro", "torch", "torchrl", "tensordict", "numba"} & set(sys.modules)
    print(*command, *loaded)
"""


def test_help_loads_neither_torch_nor_numba():
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["tyro", *(f"{name} tyro" for name in COMMANDS)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "report"),
        (["walk"], "walk"),
        (["tasks", "--wide"], "--wide"),
        (["--print-completion", "csh"], "'csh'"),
        (["report"], "runs: got none"),
        (["train"], "TASK"),
        (["train", "Walker-v0", "--total-stepz", "3"], "--total-steps"),  # what was meant
        (["train", "Walker-v0", "--material", "steel"], "invariant"),
        (["codesign", "Walker-v0", "--arm", "both"], "prescribed"),
    ],
)
def test_bad_input_is_refused(capsys, arguments, message):
    assert message in refused(capsys, *arguments)


def test_tasks_prints_every_task_with_its_ceiling(capsys):
    assert main(["tasks"]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.split() == ["id", "episode", "ceiling", "about"]
    assert {line.split()[0] for line in lines} == set(tasks)
    assert [line.split()[0] for line in lines[:6]] == list(robot_tasks.values())
    ceiling = TaskEngine("BridgeWalker-v0", STANDARD_BODY).score_ceiling[0]
    assert lines[1].split(maxsplit=3) == ["BridgeWalker-v0", "500", f"{ceiling:.2f}", "cross a soft bridge"]


def test_tasks_long_has_world_and_observations(capsys):
    main(["tasks", "--long"])
    first = capsys.readouterr().out.splitlines()[1]
    assert first.endswith("Walker-v0               velocity, relative")


def test_output_may_be_cut_short():
    command = f"{sys.executable} -m evogymcm tasks --long | head -1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert "Traceback" not in done.stderr
    assert done.stdout.startswith("id ")
    assert done.stdout.splitlines()[-1] in {"0", "141"}  # by how fast `head` is


@pytest.fixture(scope="module")
def bash_script(tmp_path_factory):
    """The script that completes commands, as a file."""
    script, printed = tmp_path_factory.mktemp("completion") / "evogymcm.bash", io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit):
        main(["--print-completion", "bash"])
    script.write_text(printed.getvalue(), encoding="utf-8")
    return script


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("evogymcm wat", "watch"),
        ("evogymcm train Walker-v0 --entr", "--entropy-weight"),
        ("evogymcm codesign Walker-v0 --material inv", "invariant"),
        ("evogymcm codesign Walker-v0 --search.acc", "--search.acceptance"),
        ("evogymcm watch Walker-v0 --view st", "stiffness"),
        ("evogymcm tasks --l", "--long"),
    ],
)
def test_bash_completes(bash_script, typed, offered):
    words = " ".join(typed.split())
    code = f"source {bash_script}; COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); "
    code += "_tyro_evogymcm; echo ${COMPREPLY[@]}"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [offered]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_a_script_with_all_commands(capsys, shell):
    text = shown(capsys, "--print-completion", shell)
    assert all(f"'{name}'" in text for name in COMMANDS)
