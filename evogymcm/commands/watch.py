"""`evogymcm watch`: robots at work, in a window or a file."""

import argparse
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evogymcm.commands._errors import checking_arguments
from evogymcm.commands._options import choose_task, default_body, read_stiffness

if TYPE_CHECKING:  # numba is loaded when the command runs, not for its help
    import numpy as np
    from tensordict.nn import TensorDictModuleBase

    from evogymcm.algos.learning.playing import Gait
    from evogymcm.envs.core import TaskEngine
    from evogymcm.envs.render.renderer import Renderer

_MATERIALS = ("reactive", "invariant")
_SEED = 0  # of tasks that draw at random
_EXAMPLES = """examples:
  evogymcm watch Walker-v0 --body Walk_Bot
  evogymcm watch Walker-v0 --body HHH/V.V --material invariant --stiffness 2,2,2/0.5,1,0.5 --view stiffness
  evogymcm watch --world terrain.json --body robot.npz
  evogymcm watch --policy runs/first --out walk.mp4
  evogymcm watch BridgeWalker-v0 --policy runs/first --body HHH/V.V HHHH/V..V    # also what it has never seen"""


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser(
        "watch",
        help="show robots at work, in a window or as a video",
        description="Shows an episode, in a window or as a video, and prints the scores.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "task", nargs="?", help="such as Walker-v0; `evogymcm tasks` lists them; default: the one of the policy's run"
    )
    parser.add_argument(
        "--world",
        type=Path,
        metavar="FILE",
        help="walk in the world of this file instead (.json of the EvoGym Design Tool, or a picture, .txt)",
    )
    parser.add_argument(
        "--body",
        nargs="+",
        help="rows of voxels (HHH/S.R), a robot's name or a file (.npz, .npy, .txt, .json); several stand side by "
        "side; default: the policy's, without one the task's own robot",
    )
    parser.add_argument("--material", choices=_MATERIALS, help="default: the policy's, without one reactive")
    parser.add_argument(
        "--stiffness",
        nargs="+",
        default=(),
        metavar="FIELD",
        help="invariant only: a number, or numbers in rows like the body's (2,2,2/0.5,1,0.5); one for all bodies or "
        "one for each; default: the policy's where the bodies are its own, else 1",
    )
    parser.add_argument(
        "--policy",
        type=Path,
        metavar="RUN",
        help="folder of a training run (its last policy) or of co-design (its best design), or one of their files, "
        "such as policy-0003.pt (design 3); default: a sine wave",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write .mp4, .gif, or .png (the last step); default where no display is",
    )
    parser.add_argument("--steps", type=int, help="env-steps at most; default: an episode")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="draw every Nth env-step")
    parser.add_argument("--view", choices=("types", "stiffness"), default="types", help="what colours show")
    parser.add_argument("--width", type=int, default=640, help="pixels across")
    parser.add_argument("--height", type=int, default=320, help="pixels up; of several bodies a tile keeps the aspect")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Shows an episode and returns the exit status.

    Raises:
        UsageError: An argument cannot be used, or a package of the extra `render` is missing.
    """
    with checking_arguments():
        for name in ("steps", "every"):
            if getattr(args, name) is not None and getattr(args, name) < 1:
                raise ValueError(f"{name}: got {getattr(args, name)}, at least 1 is needed")
        from evogymcm.envs.render.renderer import Renderer

        engine, policy = _engine(args)
        renderer = Renderer(engine, args.width, args.height, args.view)
        out = _out(args.out, engine.task.id)
    steps = args.steps or engine.task.time_limit
    _show(_pictures(engine, policy, renderer, steps, args.every), engine, out, args.every)
    for world, body in enumerate(engine.bodies):
        print(f"{body.text}: {engine.length[world]} env-steps, score {engine.score[world]:.3f}")
    return 0


def _engine(args: argparse.Namespace) -> "tuple[TaskEngine, TensorDictModuleBase | Gait]":
    """Returns the worlds and what drives them."""
    from evogymcm.body import as_body
    from evogymcm.commands._policies import load_trained, module_of
    from evogymcm.envs.core import TaskEngine
    from evogymcm.envs.gaits import sine_gait

    if args.policy is None:
        task = choose_task(args.task, args.world)
        shown = [as_body(body) for body in args.body or [default_body(task)]]
        fields, material = read_stiffness(args.stiffness, shown), args.material or "reactive"
        return TaskEngine(task, shown, material=material, stiffness=fields, seed=_SEED, with_voxels=False), sine_gait
    trained = load_trained(args.policy)
    if args.material not in (None, trained.material):
        raise ValueError(f"material: got {args.material!r}, the policy was trained with {trained.material!r}")
    if not (args.task or args.world or trained.task):
        raise ValueError(f"task: got none, and {args.policy} does not say on which one it was trained")
    task = choose_task(args.task or (None if args.world else trained.task), args.world)
    given = args.body or trained.bodies
    if not given:
        raise ValueError(f"body: got none, and {args.policy} does not say on which one it was trained (--body)")
    bodies = [as_body(body) for body in given]
    fields = read_stiffness(args.stiffness, bodies)
    if fields is None and not args.body:
        fields = trained.stiffness
    material, edge_rule = trained.material, trained.edge_rule
    engine = TaskEngine(task, bodies, material=material, stiffness=fields, edge_rule=edge_rule, seed=_SEED)
    return engine, module_of(trained.policy, engine)


def _pictures(
    engine: "TaskEngine", policy: "TensorDictModuleBase | Gait", renderer: "Renderer", steps: int, every: int
) -> "Iterator[np.ndarray]":
    """Yields pictures until the steps are done or all episodes have ended."""
    from evogymcm.algos.learning import play

    engine.set_seed(_SEED)  # playing begins with a reset, which draws what the engine has begun with
    for now in play(policy, engine, steps=steps):
        if now.step % every == 0 or now.step == steps or not now.running.any():
            yield renderer.frame() if engine.num_worlds == 1 else renderer.grid()


def _out(given: Path | None, task: str) -> Path | None:
    """Returns the file to write, None for a window.

    Raises:
        ImportError: A package that it needs is missing.
        ValueError: There is no such format or folder.
    """
    from evogymcm.envs._extras import load_imageio
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
    if suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise ImportError("MP4 needs imageio-ffmpeg: pip install evogymcm[render]")
    return out


def _show(pictures: "Iterator[np.ndarray]", engine: "TaskEngine", out: Path | None, every: int) -> None:
    """Shows pictures in a window, or writes them to a file."""
    from evogymcm.envs.render.display import Display
    from evogymcm.envs.render.renderer import FPS
    from evogymcm.envs.render.video import write_picture, write_video

    fps = FPS / every
    if out is None:
        window = Display(engine.task.id, fps)
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
