"""What goes wrong in a command's work keeps its traceback; only arguments are complained about in a line."""

import sys
from dataclasses import dataclass

import numpy as np
import pytest

from evogymcm.__main__ import main
from evogymcm.envs import Task
from tests.commands.test_codesign import TINY as SEARCH
from tests.commands.test_train import BODY
from tests.commands.test_train import TINY as TRAINING
from tests.commands.tools import refused
from tests.registries import registered


@dataclass(frozen=True)
class Broken(Task):
    """Its reward fails as soon as a robot has moved."""

    def reward(self, before, after):
        has_moved = np.any(after.x != before.x)
        return after.x - before.x if not has_moved else np.zeros(2) + np.zeros(3)


@pytest.mark.parametrize(
    "command",
    [
        ["train", "Broken-v0", "--body", BODY, *TRAINING],
        ["codesign", "Broken-v0", *SEARCH],
        ["watch", "Broken-v0", "--body", BODY, "--out", "one.png"],
    ],
    ids=lambda command: command[0],
)
def test_a_fault_in_the_work_keeps_its_traceback(command, tmp_path, monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.chdir(tmp_path)
    broken = Broken("Broken-v0", world="Walker-v0", spawn=(1, 1), time_limit=12, observes=("velocity", "relative"))
    with registered(broken), pytest.raises(ValueError, match="could not be broadcast"):
        main(command)


def test_what_the_system_says_of_an_argument_is_one_line(sprint, capsys, tmp_path):
    (tmp_path / "file").touch()
    for command in (["train", sprint, "--body", BODY, *TRAINING], ["codesign", sprint, *SEARCH]):
        said = refused(capsys, *command, "--run", "file/run")
        assert said.startswith("evogymcm: ")
        assert said.count("\n") == 1
        assert "file" in said


@pytest.mark.parametrize("module", ["pygame", "imageio.v2", "imageio_ffmpeg"])
def test_watch_names_the_missing_extra_before_it_plays(sprint, module, capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    assert "evogymcm[render]" in refused(capsys, "watch", sprint, "--body", BODY, "--out", "one.mp4")
    assert list(tmp_path.iterdir()) == []
