"""What the commands share: errors, bodies and stiffness as text, run folders, loggers, the progress bar."""

import importlib.util
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from evogymcm._messages import brief
from evogymcm._settings import WORK

if TYPE_CHECKING:  # both load torch or numba, which help texts do without
    import numpy as np
    from torchrl.record.loggers import Logger

    from evogymcm.algos.learning import Progress
    from evogymcm.algos.runs.folder import RunFolder
    from evogymcm.body import Body

INTERRUPTED = 130  # exit status after Ctrl-C, as shells have it

LoggerName = Literal["none", "csv", "tensorboard", "wandb"]


class UsageError(Exception):
    """An argument cannot be used, or the optional package that it asks for is missing."""


@contextmanager
def checking_arguments() -> Iterator[None]:
    """Turns what the library says of arguments, missing packages and files into a UsageError.

    Only what comes before a command's work belongs in here: the same kinds of errors from the work itself are faults,
    and hiding where they come from would cost hours.
    """
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        raise UsageError(str(error)) from error


def choose_task(task: str | None, world: Path | None) -> str:
    """Returns the task meant by TASK and --world: an id, or the file of the world to walk in."""
    if world is None:
        if not task:
            raise ValueError("TASK: needed, such as Walker-v0 (`evogymcm tasks` lists them), or --world FILE")
        return task
    if task not in (None, "", "Walker-v0"):
        raise ValueError(f"world: the task in a file is to walk, got {task!r} too; leave it out")
    from evogymcm.sim.world import World

    World.load(world)
    return str(world)


def read_stiffness(texts: Sequence[str], bodies: "Sequence[str | Body]") -> "list[np.ndarray] | None":
    """Returns a field for each body; None where nothing is given.

    Args:
        texts: one for all bodies or one for each: a number, or numbers separated by ',' in rows separated by '/'.
        bodies: bodies, rows of voxels or names.
    """
    if not texts:
        return None
    import numpy as np

    from evogymcm.body import as_body, check_stiffness

    if len(texts) not in (1, len(bodies)):
        raise ValueError(f"stiffness: got {len(texts)} for {len(bodies)} bodies, expected 1 or {len(bodies)}")
    fields = []
    for text, spec in zip(texts if len(texts) > 1 else list(texts) * len(bodies), bodies, strict=True):
        try:
            rows = [[float(number) for number in row.split(",")] for row in text.split("/")]
        except ValueError:
            raise ValueError(
                f"stiffness: got {brief(text)}, expected a number or rows such as 2,2,2/0.5,1,0.5"
            ) from None
        if len({len(row) for row in rows}) > 1:
            raise ValueError(f"stiffness: got {brief(text)}, whose rows differ in length")
        body = as_body(spec)
        field = np.array(rows)
        fields.append(check_stiffness(np.full(body.shape, field.item()) if field.size == 1 else field, body))
    return fields


def write_stiffness(field: "np.ndarray", occupancy: "np.ndarray") -> list[str]:
    """Returns the rows of a field for reading, with two decimals, and '.' where there is no voxel."""
    rows = zip(field, occupancy, strict=True)
    return [
        " ".join(f"{value:4.2f}" if is_there else "   ." for value, is_there in zip(*row, strict=True)) for row in rows
    ]


def work_lines(work: Mapping[str, float]) -> list[str]:
    """Returns what is printed of the mean work of episodes, given by the names in tables: nothing where it is not."""
    if WORK[0] not in work:
        return []
    supplied = [f"{work[name]:,.0f} of {name.split('_')[0]}" for name in WORK[:2]]
    return [f"work    {' and '.join(supplied)}: what commands supplied in an episode"]


def open_run(path: Path, config: dict[str, Any], *, resume: bool, overwrite: bool) -> "RunFolder":
    """Opens a run's folder, or raises a ValueError that says which options help."""
    from evogymcm.algos.runs.folder import RunFolder, RunInUseError

    try:
        folder = RunFolder(path, config, resume=resume, overwrite=overwrite)
        with folder.lock():  # taken again for the work itself; told here, it is one line
            return folder
    except RunInUseError as error:
        raise ValueError(f"run: {error}; wait, or choose another folder (--run)") from None
    except FileExistsError as error:
        if not (path / "config.json").is_file():
            raise ValueError(f"run: {error}; choose another folder (--run)") from None
        raise ValueError(
            f"run: {path} exists; continue it (--resume), replace it (--overwrite) or choose another folder (--run)"
        ) from None


def check_logger(kind: LoggerName) -> None:
    """Raises an ImportError, naming the extra, where a logger's package is missing."""
    if kind in ("tensorboard", "wandb") and importlib.util.find_spec(kind) is None:
        raise ImportError(f"logger: {kind!r} needs the package {kind}: pip install evogymcm[{kind}]")


def make_logger(kind: LoggerName, folder: Path) -> "Logger | None":
    """Returns TorchRL's logger that writes into `folder`, None for "none"."""
    if kind == "none":
        return None
    from torchrl.record.loggers import get_logger

    name = folder.name if kind == "wandb" else kind  # W&B shows it; the others name a folder by it
    return get_logger(kind, str(folder), name, wandb_kwargs={"project": "evogymcm"})


def how_to_resume(command: str, arguments: Sequence[str]) -> str:
    """Returns the command line that goes on with a stopped run."""
    kept = [argument for argument in arguments if argument not in ("--resume", "--overwrite")]
    return shlex.join(["evogymcm", command, *kept, "--resume"])


def print_beginning(run: "RunFolder") -> None:
    """Says what training began with."""
    from evogymcm.algos.runs import RunRecord

    initial = RunRecord.read(run.path).initial
    words = {
        "fresh": "random weights",
        "baseline": "the package's policy for the task (--initial fresh: random weights)",
    }
    print(f"begun   with {words.get(str(initial), initial)}")


class Bar:
    """A progress bar of env-steps on stderr; rate and time left are those of this sitting.

    Args:
        total: env-steps of the whole run, those of earlier sittings included.
    """

    def __init__(self, total: int) -> None:
        self.total = total
        self._bar: Any = None

    def show(self, done: int, numbers: Mapping[str, str]) -> None:
        """Moves the bar to `done` env-steps, with numbers beside it."""
        if self._bar is None:
            from tqdm import tqdm

            pause = 0.1 if sys.stderr.isatty() else 30.0  # seconds; a log file needs few lines
            options = {"unit": " env-steps", "unit_scale": True, "dynamic_ncols": True, "mininterval": pause}
            self._bar = tqdm(total=max(self.total, done), initial=done, file=sys.stderr, **options)
        self._bar.set_postfix(numbers, refresh=False)
        self._bar.update(done - self._bar.n)

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()


def show_training(bar: Bar, latest: dict[str, str], state: "Progress") -> None:
    """Moves the bar of a training; `latest` keeps the score until the next evaluation."""
    if "score" in state.row:
        latest["score"] = f"{state.row['score']:.3f}"
    bar.show(state.env_steps, latest)
