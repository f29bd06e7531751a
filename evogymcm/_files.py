"""Files that readers see whole or not at all."""

import os
from collections.abc import Callable
from pathlib import Path


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Lets `write` make a file and puts it at `path` in one step: readers see the old file or the new one, whole.

    Where that fails, as on a full disk, nothing is left behind but the old file.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        write(part)
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
