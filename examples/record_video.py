"""Records a population: all bodies side by side, as an MP4 or GIF. Needs `pip install evogymcm[render]`."""

import sys
import tempfile
from pathlib import Path

import numpy as np

import evogymcm as cm
from evogymcm.algos.learning import play
from evogymcm.envs import Renderer, TaskEngine, sine_gait, write_video


def main(path: str = "population.mp4", steps: int = 150) -> None:
    """Lets twelve random bodies walk to a sine wave and films them."""
    rng = np.random.default_rng(0)
    engine = TaskEngine("Walker-v0", [cm.sample_body((5, 5), rng) for _ in range(12)], material="reactive")
    renderer = Renderer(engine, width=1280, height=640)

    frames = (renderer.grid(columns=4) for _ in play(sine_gait, engine, steps=steps))
    print(f"wrote {write_video(path, frames)}; best return {engine.returns.max():.2f}")


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "population.mp4"
        main(str(path), steps=2)
        assert path.stat().st_size > 0


if __name__ == "__main__":
    main(*sys.argv[1:2])
