"""What a process says of itself, in a file that keeps its room: it can still be told that the disk is full."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_NAME, _ROOM = "job.json", 4096  # bytes


class Note:
    """A small file, written in place.

    Args:
        folder: Where it is.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME

    def write(self, told: Mapping[str, Any]) -> None:
        """Writes numbers and texts; texts that are too long are cut."""
        text = json.dumps(told)
        while len(text) >= _ROOM:  # JSON is plain ASCII
            longest = max((key for key in told if isinstance(told[key], str)), key=lambda key: len(told[key]))
            told = {**told, longest: told[longest][: len(told[longest]) // 2]}
            text = json.dumps(told)
        flags = os.O_WRONLY | os.O_CREAT  # not cut short: a full disk has no room for what was given up
        with os.fdopen(os.open(self._path, flags, 0o644), "wb") as file:
            file.write(text.ljust(_ROOM - 1).encode() + b"\n")

    def read(self) -> dict[str, Any]:
        """Returns what was written last, {} where there is nothing."""
        try:
            told = json.loads(self._path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return told if isinstance(told, dict) else {}
