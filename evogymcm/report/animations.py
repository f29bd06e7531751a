"""Short animations of designs under their policies, as GIFs within the page."""

import base64
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evogymcm.algos.runs.record import GAIT, KINDS, RunRecord
from evogymcm.report.sources import Arm
from evogymcm.report.tables import tasks_of

MOST, LARGEST = 4, 400_000  # animations; bytes of a GIF
STEPS, EVERY = 250, 4  # env-steps that are shown, and of which every fourth is drawn
WIDTH, HEIGHT = 360, 200


Scene = tuple[Arm, RunRecord, Path]  # a run and the file of its policy


def choose_scenes(arms: Sequence[Arm]) -> tuple[list[Scene], list[str]]:
    """Returns the best run of each arm and task, up to four, and why others are missing."""
    scenes: list[Scene] = []
    reasons: list[str] = []
    tasks = dict.fromkeys([*tasks_of(arms, "train"), *tasks_of(arms, "codesign")])
    for task in tasks:
        for arm in arms:
            for kind in KINDS:
                for run in sorted(arm.of(task, kind), key=_rank, reverse=True)[:1]:
                    try:
                        scenes.append((arm, run, _policy(run)))
                    except ValueError as error:
                        reasons.append(f"{run.name}: {error}")
    if len(scenes) > MOST:
        reasons.append(f"Shown are {MOST} of {len(scenes)}, in the order of the tables.")
    return scenes[:MOST], reasons


def _rank(run: RunRecord) -> float:
    scores = (run.final_of("score"), run.best_score)  # of co-design: the best design's
    return next((score for score in scores if score is not None), -np.inf)


def _policy(run: RunRecord) -> Path:
    """Returns the file of the policy of a run's best design, or raises a ValueError that says why there is none."""
    if run.path is None:
        raise ValueError("the run's folder is missing.")
    if run.kind == "train" and run.body is None:
        raise ValueError("the run's settings do not name the one body that it has.")
    names = ("final.pt", "best.pt") if run.kind == "train" else (f"policy-{run.ranked()[0]['index']:04}.pt", GAIT)
    for name in names:
        if (run.path / name).is_file():
            return run.path / name
    raise ValueError("there is no saved policy." if run.kind == "train" else f"there is no {names[0]}.")


def animate(arm: Arm, run: RunRecord, policy: Path) -> tuple[str, str]:
    """Returns the GIF as a data URI, and its caption."""
    from evogymcm.algos.gaits import load_gaits
    from evogymcm.algos.learning import play
    from evogymcm.algos.runs import load_policy
    from evogymcm.envs import Renderer
    from evogymcm.envs.engines import engine_of

    saved: Any
    if policy.name == GAIT:
        saved = load_gaits(policy)
        env, drive = saved.make_engine(1, task=run.task, num_threads=1), saved.waves
    else:
        saved = load_policy(policy)
        env = saved.make_env(1, task=run.task, num_threads=1)
        drive = saved.module(env)
    try:
        renderer, episode = Renderer(env, WIDTH, HEIGHT), play(drive, env, steps=STEPS)
        frames = [renderer.frame() for now in episode if now.step % EVERY == 0 or not now.running.any()]
    finally:
        engine_of(env).close()
    which = f"{policy.stem} policy" if run.kind == "train" else f"number {run.ranked()[0]['index']}"
    what = f"{which}, {saved.material} stiffness, env-steps 0 to {engine_of(env).length[0]}"
    return gif_uri(frames), f"{arm.title(run)}: {what}"


def gif_uri(frames: Sequence[np.ndarray], largest: int = LARGEST) -> str:
    """Returns a GIF as a data URI; every other picture is left out until it is small enough."""
    from evogymcm.envs.render.renderer import FPS
    from evogymcm.envs.render.video import write_video

    every = EVERY
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "animation.gif"
        while True:
            write_video(path, frames, FPS / every)
            if path.stat().st_size <= largest:
                return "data:image/gif;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
            if len(frames) <= 2:
                raise ValueError(f"animation: two pictures need more than {largest:,} bytes")
            frames, every = frames[::2], 2 * every
