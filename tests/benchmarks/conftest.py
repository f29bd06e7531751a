"""An EvoGym for programs that run beside ours."""

import sys
import textwrap
from pathlib import Path

import pytest

# Enough of EvoGym for the process that trains on it. At its end it writes down how many steps it has made.
FAKE_EVOGYM = """
    import atexit
    from pathlib import Path

    import gymnasium
    import numpy as np

    print("Using a fake simulator")
    counted = [0]
    atexit.register(lambda: Path(__file__).with_name("steps").write_text(str(counted[0])))

    class Env(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-1.0, 1.0, (3,))

        def __init__(self, body, connections):
            assert connections.shape[0] == 2
            self.action_space = gymnasium.spaces.Box(0.6, 1.6, (int(np.isin(body, (3, 4)).sum()),), np.float64)

        def reset(self, seed=None, options=None):
            self.steps = 0
            return np.zeros(3, np.float32), {}

        def step(self, action):
            assert action.shape == self.action_space.shape
            assert self.steps < 50, "not reset"
            self.steps += 1
            counted[0] += 1
            return np.zeros(3, np.float32), 0.0, False, self.steps == 50, {}

    gymnasium.register("Walker-v0", Env)
"""


@pytest.fixture
def fake_evogym(tmp_path) -> Path:
    """An interpreter that finds a fake evogym beside what is installed."""
    package = tmp_path / "evogym"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "envs.py").write_text(textwrap.dedent(FAKE_EVOGYM), encoding="utf-8")
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{tmp_path}" exec "{sys.executable}" "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    return python
