"""`evogymcm watch`: robots at work, in a window or a file."""

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # numba is loaded when the command runs, not for its help
    import numpy as np

    from evogymcm.envs.core import TaskEngine
    from evogymcm.envs.render import Renderer

    Control = Callable[[TaskEngine], tuple[np.ndarray, np.ndarray | None]]

_STANDARD_BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"
_MATERIALS = ("reactive", "invariant")


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser("watch", help="show robots at work, in a window or as a video")
    parser.add_argument("task", help="such as Walker-v0; `evogymcm tasks` lists them")
    parser.add_argument(
        "--body",
        nargs="+",
        help="rows of voxels (HHH/S.R) or a robot's name; several stand side by side; default: the task's own robot",
    )
    parser.add_argument("--material", choices=_MATERIALS, help="default: the policy's, without one reactive")
    parser.add_argument("--policy", type=Path, metavar="RUN", help="a training run's folder; default: a sine wave")
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
        ValueError: An argument cannot be used.
    """
    for name in ("steps", "every"):
        if getattr(args, name) is not None and getattr(args, name) < 1:
            raise ValueError(f"{name}: got {getattr(args, name)}, at least 1 is needed")
    from evogymcm import robot_tasks
    from evogymcm.envs.core import TaskEngine
    from evogymcm.envs.gaits import sine_gait
    from evogymcm.envs.render import Renderer

    control: Control
    if args.policy is None:
        control, material = sine_gait, args.material or "reactive"
    else:
        control, material = _load_policy(args.policy)
        if args.material not in (None, material):
            raise ValueError(f"material: got {args.material!r}, the policy was trained with {material!r}")
    own = next((robot for robot, task in robot_tasks.items() if task == args.task), _STANDARD_BODY)
    engine = TaskEngine(args.task, args.body or [own], material=material, seed=0, with_voxels=args.policy is not None)
    try:
        renderer = Renderer(engine, args.width, args.height, args.view)
        _show(_pictures(engine, control, renderer, args.steps or engine.task.time_limit, args.every), engine, args)
    except ImportError as error:
        print(f"evogymcm: {error}", file=sys.stderr)
        return 2
    for world, body in enumerate(engine.bodies):
        print(f"{body.text}: {engine.length[world]} env-steps, score {engine.score[world]:.3f}")
    return 0


def _pictures(
    engine: "TaskEngine", control: "Control", renderer: "Renderer", steps: int, every: int
) -> "Iterator[np.ndarray]":
    """Yields pictures until the steps are done or all episodes have ended."""
    going = ~(engine.terminated | engine.truncated)
    for step in range(steps + 1):
        is_last = step == steps or not going.any()
        if step % every == 0 or is_last:
            yield renderer.frame() if engine.num_worlds == 1 else renderer.grid()
        if is_last:
            return
        engine.step(*control(engine), going)
        going = ~(engine.terminated | engine.truncated)


def _show(pictures: "Iterator[np.ndarray]", engine: "TaskEngine", args: argparse.Namespace) -> None:
    """Shows pictures in a window, or writes them to a file."""
    from evogymcm.envs._human import Window, has_display
    from evogymcm.envs.render import FPS
    from evogymcm.envs.video import write_picture, write_video

    fps = FPS / args.every
    if args.out is None and has_display():
        window = Window(engine.task.id, fps)
        for picture in pictures:
            if not window.show(picture):
                break
        window.close()
        return
    out = args.out or Path(f"{engine.task.id}.mp4")
    if out.suffix.lower() == ".png":
        *_, last = pictures
        write_picture(out, last)
    else:
        write_video(out, pictures, fps)
    print(f"wrote {out}")


def _load_policy(run: Path) -> "tuple[Control, str]":
    """Returns the last policy of a training run as deterministic control, and its material.

    Raises:
        ValueError: There is no policy.
    """
    import numpy as np
    import torch
    from tensordict import TensorDict
    from torchrl.envs import ExplorationType, set_exploration_type

    from evogymcm.algos.actor import load_actor

    path = next((path for path in (run / "final.pt", run / "best.pt", run) if path.is_file()), None)
    if path is None:
        raise ValueError(f"policy: {run} has neither final.pt nor best.pt")
    actor = load_actor(torch.load(path, weights_only=True))
    material = "reactive" if "stiffness" in actor.ranges else "invariant"

    def control(engine: "TaskEngine") -> "tuple[np.ndarray, np.ndarray | None]":
        seen = {
            "voxels": engine.voxels,
            "types": engine.types,
            "task": engine.features.astype(np.float32),
            "occupancy": engine.occupancy,
            "actuators": engine.actuators,
        }
        td = TensorDict({key: torch.from_numpy(value) for key, value in seen.items()}, [engine.num_worlds])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            action = actor(td)["action"]
        return action["actuation"].numpy(), action["stiffness"].numpy() if material == "reactive" else None

    return control, material
