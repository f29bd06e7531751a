"""Short animations of designs under their policies, as GIFs within the page."""

import base64
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evogymcm.algos.runs.record import KINDS, Row, RunRecord
from evogymcm.report.sources import Arm
from evogymcm.report.tables import tasks_of

MOST, LARGEST = 4, 400_000  # animations; bytes of a GIF
STEPS, EVERY = 250, 4  # env-steps that are shown, and of which every fourth is drawn
WIDTH, HEIGHT = 360, 200


@dataclass(frozen=True)
class Scene:
    """What to show.

    Attributes:
        run: the run whose policy acts.
        arm: label of the run's arm.
        policy: file of the policy.
        design: a record of the body and its stiffness in co-design, None in training.
    """

    run: RunRecord
    arm: str
    policy: Path
    design: Row | None


def choose_scenes(arms: Sequence[Arm]) -> tuple[list[Scene], list[str]]:
    """Returns the best run of each arm and task, up to four, and why others are missing."""
    scenes, reasons = [], []
    tasks = dict.fromkeys([*tasks_of(arms, "train"), *tasks_of(arms, "codesign")])
    for task in tasks:
        for arm in arms:
            for kind in KINDS:
                runs = sorted(arm.of(task, kind), key=_rank, reverse=True)
                found = [scene_of(run, arm.label) for run in runs[:1]]
                scenes += [scene for scene in found if isinstance(scene, Scene)]
                reasons += [reason for reason in found if isinstance(reason, str)]
    if len(scenes) > MOST:
        reasons.append(f"Shown are {MOST} of {len(scenes)}, in the order of the tables.")
    return scenes[:MOST], reasons


def _rank(run: RunRecord) -> float:
    scores = (run.final_of("score"), run.best_score)  # of co-design: the best design's
    return next((score for score in scores if score is not None), -np.inf)


def scene_of(run: RunRecord, arm: str) -> Scene | str:
    """Returns the scene of a run's best design, or why there is none."""
    if run.path is None:
        return f"{run.name}: the run's folder is missing."
    if run.kind == "train":
        policy = next((run.path / name for name in ("final.pt", "best.pt") if (run.path / name).is_file()), None)
        if run.body is None:
            return f"{run.name}: the run's settings do not name the one body that it has."
        return Scene(run, arm, policy, None) if policy else f"{run.name}: there is no saved policy."
    best = run.ranked()[0]
    policy = run.path / f"policy-{best['index']:04}.pt"
    return Scene(run, arm, policy, best) if policy.is_file() else f"{run.name}: there is no {policy.name}."


def animate(scene: Scene) -> tuple[str, str]:
    """Returns the GIF as a data URI, and its caption.

    Raises:
        ImportError: A package of the extra `render` is missing.
        ValueError: The policy or design cannot be used, or the GIF would be too large.
    """
    from evogymcm.algos.learning import play
    from evogymcm.algos.runs import load_policy
    from evogymcm.envs import Renderer

    run, saved = scene.run, load_policy(scene.policy)
    env = saved.make_env(1, task=run.task, num_threads=1)
    renderer, episode = Renderer(env, WIDTH, HEIGHT), play(saved.module(env), env, steps=STEPS)
    frames = [renderer.frame() for now in episode if now.step % EVERY == 0 or not now.running.any()]
    which = f"number {scene.design['index']}" if scene.design else f"{scene.policy.stem} policy"
    seed = "" if run.seed is None else f", seed {run.seed}"
    caption = (
        f"{run.task}, {scene.arm}{seed}: {which}, {saved.material} stiffness, env-steps 0 to {env.engine.length[0]}"
    )
    return gif_uri(frames), caption


def gif_uri(frames: Sequence[np.ndarray], largest: int = LARGEST) -> str:
    """Returns a GIF as a data URI; every other picture is left out until it is small enough.

    Raises:
        ValueError: Two pictures are still too large.
    """
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
