"""`evogymcm watch`: robots in motion, in a window or a file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import arg

from evogymcm._settings import Material, check_count
from evogymcm.algos.learning.bodies import default_body
from evogymcm.commands._options import checking_arguments, choose_task, read_stiffness

if TYPE_CHECKING:  # torch and numba are loaded when the command runs, not for its help
    import numpy as np
    from tensordict.nn import TensorDictModuleBase

    from evogymcm.algos.learning.playing import Gait
    from evogymcm.envs import SoftRobotEnv, TaskEngine

DESCRIPTION = """Shows an episode, in a window or as a video, and prints the scores.

examples:
  evogymcm watch Walker-v0 --body Walk_Bot
  evogymcm watch Walker-v0 --body HHH/V.V --stiffness 2,2,2/0.5,1,0.5 --view stiffness
  evogymcm watch --world terrain.json --body robot.npz
  evogymcm watch --policy runs/first --out walk.mp4
  evogymcm watch BridgeWalker-v0 --policy runs/first --body HHH/V.V HHHH/V..V    # also what it has never seen"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        task: id of the task, such as Walker-v0; `evogymcm tasks` lists all.
        world: walk in the world of this file instead (.json of the EvoGym Design Tool, or a picture, .txt).
        body: rows of voxels (HHH/S.R), a robot's name or a file (.npz, .npy, .txt, .json); several stand side by side.
        material: whether the policy sets stiffness too ("reactive"), or stiffness belongs to the body.
        stiffness: invariant setting only: a number, or numbers in rows like the body's (2,2,2/0.5,1,0.5); one for all
            bodies or one for each.
        policy: folder of a training run (its last policy), of co-design or of an evolution (its best design), or one of
            their files, such as policy-0003.pt (design 3); or gaits (.json) of `evogymcm gait`.
        out: file to write: .mp4, .gif, or .png (the last step).
        steps: env-steps at most.
        every: draw every Nth env-step.
        view: what colours show.
        width: pixels across.
        height: pixels up; with several bodies each tile keeps the aspect.
    """

    task: Annotated[tyro.conf.Positional[str], arg(metavar="TASK", help_behavior_hint="(default: the policy's)")] = ""
    world: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    body: Annotated[
        tuple[str, ...], arg(metavar="BODY", help_behavior_hint="(default: the policy's, or the task's own robot)")
    ] = ()
    material: Annotated[Material | None, arg(help_behavior_hint="(default: the policy's, or invariant)")] = None
    stiffness: Annotated[
        tuple[str, ...], arg(metavar="FIELD", help_behavior_hint="(default: the policy's for its own bodies, or 1)")
    ] = ()
    policy: Annotated[Path | None, arg(metavar="RUN", help_behavior_hint="(default: a sine wave)")] = None
    out: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: TASK.mp4 without a display)")] = None
    steps: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: an episode)")] = None
    every: Annotated[int, arg(metavar="N")] = 1
    view: Literal["types", "stiffness"] = "types"
    width: int = 640
    height: int = 320


def run(options: Options, arguments: Sequence[str]) -> int:
    """Shows an episode and returns the exit status."""
    with checking_arguments():
        for name in ("steps", "every"):
            if getattr(options, name) is not None:
                check_count(name, getattr(options, name))
        from evogymcm.envs.render.renderer import Renderer

        env, policy = _worlds(options)
        renderer = Renderer(env, options.width, options.height, options.view)
        engine = renderer.engine
        out = _out(options.out, engine.task.id)
    from evogymcm.algos.learning import play

    engine.set_seed(0)  # the same episode whenever it is watched
    steps = options.steps or engine.task.time_limit
    pictures = (
        renderer.frame() if engine.num_worlds == 1 else renderer.grid()
        for now in play(policy, env, steps=steps)
        if now.step % options.every == 0 or now.step == steps or not now.running.any()
    )
    _show(pictures, engine.task.id, out, options.every)
    for world, body in enumerate(engine.bodies):
        print(f"{body.text}: {engine.length[world]} env-steps, score {engine.score[world]:.3f}")
    return 0


def _worlds(options: Options) -> "tuple[TaskEngine | SoftRobotEnv, TensorDictModuleBase | Gait]":
    """Returns the worlds and what drives them."""
    from evogymcm.body import as_body
    from evogymcm.envs import TaskEngine, sine_gait

    if options.policy is None:
        task = choose_task(options.task, options.world)
        shown = [as_body(body) for body in options.body or [default_body(task)]]
        fields, material = read_stiffness(options.stiffness, shown), options.material or "invariant"
        return TaskEngine(task, shown, material=material, stiffness=fields, with_voxels=False), sine_gait
    from evogymcm.algos.gaits.stored import gaits_in

    if gaits_in(options.policy):
        return _with_gaits(options, options.policy)
    from evogymcm.algos.runs import load_policy

    saved = load_policy(options.policy)
    if options.material not in (None, saved.material):
        raise ValueError(f"material: got {options.material!r}, the policy was trained with {saved.material!r}")
    other = choose_task(options.task, options.world) if options.task or options.world else None
    bodies = [as_body(body) for body in options.body]
    fields = read_stiffness(options.stiffness, bodies or saved.bodies)
    env = saved.make_env(task=other, bodies=bodies, stiffness=fields)
    return env, saved.module(env)


def _with_gaits(options: Options, path: Path) -> "tuple[TaskEngine, Gait]":
    """Returns the worlds of saved gaits, and the gaits; each keeps its own body, or one moves other bodies."""
    from evogymcm.algos.gaits import load_gaits
    from evogymcm.body import as_body

    saved = load_gaits(path)
    if options.material not in (None, saved.material):
        raise ValueError(f"material: got {options.material!r}, the gait was found with {saved.material!r}")
    bodies = [as_body(body) for body in options.body]
    if bodies and len(saved.bodies) > 1:
        raise ValueError(f"body: got {len(bodies)}, {path} holds a gait for each of {len(saved.bodies)} bodies")
    fields = read_stiffness(options.stiffness, bodies or saved.bodies)
    other = choose_task(options.task, options.world) if options.task or options.world else saved.task
    if fields is None and not bodies and saved.stiffness is not None:
        fields = list(saved.stiffness)
    return saved.make_engine(task=other, bodies=bodies or list(saved.bodies), stiffness=fields), saved.waves


def _out(given: Path | None, task: str) -> Path | None:
    """Returns the file to write, None for a window."""
    from evogymcm._extras import load_ffmpeg, load_imageio
    from evogymcm.envs.render.display import has_display
    from evogymcm.envs.render.video import VIDEOS

    if given is None and has_display():
        return None
    out = given or Path(f"{Path(task).stem}.mp4")
    suffix = out.suffix.lower()
    if suffix not in (".png", *VIDEOS):
        raise ValueError(f"out: got {out.name!r}, allowed suffixes are .png, {', '.join(VIDEOS)}")
    if not out.parent.is_dir():
        raise ValueError(f"out: the folder {out.parent} does not exist")
    load_imageio()
    if suffix == ".mp4":
        load_ffmpeg()
    return out


def _show(pictures: "Iterator[np.ndarray]", task: str, out: Path | None, every: int) -> None:
    """Shows pictures in a window, or writes them to a file."""
    from evogymcm.envs.render.display import Display
    from evogymcm.envs.render.renderer import FPS
    from evogymcm.envs.render.video import write_picture, write_video

    fps = FPS / every
    if out is None:
        window = Display(task, fps)
        for picture in pictures:
            if not window.show(picture):
                break
        window.close()
        return
    if out.suffix.lower() == ".png":
        *_, last = pictures
        write_picture(out, last)
    else:
        write_video(out, pictures, fps)
    print(f"wrote {out}")
