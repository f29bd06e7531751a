"""Designs kept as files in a folder: written in one step, opened by checked names only."""

import json
import os
import re
import secrets
import shutil
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evogymcm._files import write_atomic
from evogymcm._messages import brief
from evogymcm._settings import check_choice
from evogymcm.algos.learning.config import BASELINE
from evogymcm.body import FILE_SUFFIXES, robots
from evogymcm.envs.tasks import tasks
from evogymcm.studio.drawing import Drawing
from evogymcm.studio.sketch import check_keys, check_text
from evogymcm.studio.terrain import Terrain

ID = re.compile(r"[a-z0-9](?:[a-z0-9-]{0,38}[a-z0-9])?")
RUN = re.compile(r"(train|material|evolve)-([1-9][0-9]{0,3})")
GAITS = {"sine": "Sine gait", "random": "Random actions", "still": "Neutral actions"}
_POLICY = re.compile(rf"{ID.pattern}/{RUN.pattern}(/policy-[0-9]{{4}})?|given:[^/\n]{{1,200}}")
TERRAIN = "terrain"  # the task to walk in the terrain that is drawn
LONGEST_NAME = 60
LARGEST_FILE = 200_000  # bytes of a design
_KEYS = ("name", "task", "material", "policy", "design", "terrain")


@dataclass
class Design:
    """What is kept of a design.

    Attributes:
        name: Any text on one line.
        task: Id of its task, or "terrain" for its own.
        material: "invariant" or "reactive".
        policy: What moves it: a gait, or a run of the studio, see `check_policy`.
        drawing: Body and stiffness.
        terrain: Its own world.
    """

    name: str = "My robot"
    task: str = "Walker-v0"
    material: str = "invariant"
    policy: str = "sine"
    drawing: Drawing = field(default_factory=Drawing.blank)
    terrain: Terrain = field(default_factory=Terrain.flat)

    def record(self) -> dict[str, Any]:
        """Returns the design as JSON has it; `from_record` reads it back."""
        return {
            "name": self.name,
            "task": self.task,
            "material": self.material,
            "policy": self.policy,
            "design": self.drawing.record(),
            "terrain": self.terrain.record(),
        }

    @classmethod
    def from_record(cls, record: object) -> "Design":
        """Returns the design that `record` wrote; only its drawing must be given.

        Raises:
            ValueError: It is something else, or holds what cannot be drawn.
        """
        given = check_keys("design", record, _KEYS)
        drawing = Drawing.from_record(check_keys("design", given.get("design"), ("body", "stiffness")))
        design = cls(drawing=drawing)
        design.rename(given.get("name", design.name))
        design.task = check_task(given.get("task", design.task))
        design.material = check_choice("material", given.get("material", design.material), ("invariant", "reactive"))
        design.policy = check_policy(given.get("policy", design.policy))
        if given.get("terrain") is not None:
            design.terrain = Terrain.from_record(check_keys("terrain", given["terrain"], ("cells",)))
        return design

    @classmethod
    def read(cls, text: str) -> "Design":
        """Returns the design in a text: its JSON, rows of a body, or the name of one of `robots`.

        Raises:
            ValueError: It is none of them.
        """
        text = text.strip()
        if text.startswith("{"):
            try:
                return cls.from_record(json.loads(text))
            except (json.JSONDecodeError, RecursionError) as error:
                raise ValueError(f"design: it is not JSON ({error})") from error
        if text in robots:
            return cls(name=text, drawing=Drawing.of(robots[text]))
        return cls(drawing=Drawing.from_record({"body": text}))

    @classmethod
    def read_file(cls, name: str, content: bytes) -> "Design":
        """Returns the design in a file that somebody brings: one of a studio, or a body that `as_body` takes.

        Raises:
            ValueError: It is neither.
        """
        try:
            text = content.decode()
        except UnicodeDecodeError:
            text = ""
        suffix = Path(name).suffix.lower()
        if suffix == ".json" and '"grid_width"' not in text:
            return cls.read(text)
        if suffix not in FILE_SUFFIXES:
            raise ValueError(f"file: got {brief(name)}, expected one that ends with {', '.join(FILE_SUFFIXES)}")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"body{suffix}"
            path.write_bytes(content)
            design = cls(drawing=Drawing.of(path))
        design.rename(" ".join(Path(name).stem.split())[:LONGEST_NAME])
        return design

    def rename(self, name: object) -> None:
        """Sets the name; ValueError where it is no line of text."""
        words = " ".join(check_text("name", name, LONGEST_NAME).split())
        if not words or not words.isprintable():
            raise ValueError(f"name: got {brief(name)}, expected one line of text")
        self.name = words


def check_policy(policy: object) -> str:
    """Returns what moves a robot; ValueError where it is something else.

    It is one of `GAITS`, "baseline", a run as "DESIGN/RUN", one of its policies as "DESIGN/RUN/policy-0003", or a run
    that the studio was given, as "given:NAME".
    """
    if isinstance(policy, str) and (policy in (*GAITS, BASELINE) or _POLICY.fullmatch(policy)):
        return policy
    raise ValueError(f"policy: got {brief(policy)}, expected one of {', '.join(GAITS)}, {BASELINE}, or a run")


def check_task(task: object) -> str:
    """Returns the id of a task, or "terrain"; ValueError where it is neither."""
    if task != TERRAIN and task not in tasks:
        raise ValueError(f"task: got {brief(task)}, expected one of {len(tasks)} ids or {TERRAIN!r}")
    return str(task)


@dataclass(frozen=True)
class Entry:
    """A line of the list of designs: id, name, what is drawn, and when it was changed (seconds since 1970)."""

    id: str
    name: str
    drawing: Drawing
    changed: float


class Store:
    """A folder of designs, of their terrains as files that tasks read, and of their runs.

    Args:
        folder: Made where there is none.

    Raises:
        ValueError: It is no folder, or cannot be made.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder).expanduser().resolve()
        try:
            for part in ("designs", "worlds", "runs", "deleted"):
                (self.folder / part).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"folder: {brief(str(folder))} cannot be used ({error.strerror})") from error

    def path(self, part: str, id: str, suffix: str = "") -> Path:
        """Returns the path of a design's file or folder in a part of the folder.

        Raises:
            ValueError: The id is no id, or what it names leads out of the folder.
        """
        if not isinstance(id, str) or not ID.fullmatch(id):
            raise ValueError(f"design: got the id {brief(id)}, expected letters a to z, digits and '-', at most 40")
        path = self.folder / part / f"{id}{suffix}"
        if path.is_symlink() or not path.resolve().is_relative_to(self.folder):
            raise ValueError(f"design: {id} leads out of the folder")
        return path

    def entries(self) -> list[Entry]:
        """Returns the designs, the one changed last first. Files that cannot be read are left out."""
        found = []
        for path in (self.folder / "designs").glob("*.json"):
            try:
                design = self.load(path.stem)
                found.append(Entry(path.stem, design.name, design.drawing, path.stat().st_mtime))
            except (ValueError, OSError):
                continue
        return sorted(found, key=lambda entry: (-entry.changed, entry.id))

    def load(self, id: str) -> Design:
        """Returns a design.

        Raises:
            ValueError: There is none of that id, or its file cannot be read.
        """
        path = self.path("designs", id, ".json")
        if not path.is_file():
            raise ValueError(f"design: there is no {id}")
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError(f"design {id}: its file has more than {LARGEST_FILE:,} bytes")
        return Design.read(path.read_text(encoding="utf-8"))

    def save(self, id: str, record: dict[str, Any]) -> None:
        """Writes the record of a design, whole or not at all.

        Raises:
            ValueError: The id is no id.
            OSError: It cannot be written, as on a full disk; the former file is still there.
        """
        text = json.dumps(record, indent=1, ensure_ascii=False)
        write_atomic(self.path("designs", id, ".json"), lambda part: part.write_text(text, encoding="utf-8"))

    def add(self, design: Design) -> str:
        """Writes a new design and returns its id, which comes from its name; OSError as `save`."""
        base = re.sub(r"[^a-z0-9]+", "-", design.name.lower()).strip("-")[:30].strip("-") or "robot"
        id = base
        while self.path("designs", id, ".json").exists() or self.path("runs", id).exists():
            id = f"{base}-{secrets.token_hex(3)}"
        self.save(id, design.record())
        return id

    def delete(self, id: str) -> None:
        """Moves a design and its runs to the folder "deleted", where they can be taken from by hand."""
        stamp = time.strftime("%Y%m%d-%H%M%S") + f"-{secrets.token_hex(2)}"
        for part, suffix in (("designs", ".json"), ("worlds", ".txt"), ("runs", "")):
            path = self.path(part, id, suffix)
            if path.exists():
                shutil.move(path, self.folder / "deleted" / f"{id}-{stamp}-{part}{suffix}")

    def runs(self, id: str) -> Path:
        """Returns the folder of a design's runs, which need not exist."""
        return self.path("runs", id)

    def task(self, id: str, design: Design, shape: tuple[int, int]) -> str:
        """Returns the task as environments take it: its id, or the file of the design's terrain, which is written.

        Raises:
            ValueError: The terrain is no world, or has no room for a robot of that shape.
            OSError: It cannot be written.
        """
        if design.task != TERRAIN:
            return design.task
        design.terrain.task(*shape)
        picture = design.terrain.world().to_picture()
        path = self.path("worlds", id, ".txt")
        if not path.is_file() or path.read_text(encoding="utf-8") != picture:
            write_atomic(path, lambda part: part.write_text(picture, encoding="utf-8"))
        return str(path)
