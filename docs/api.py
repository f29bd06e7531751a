"""Writes the page of the API, and the list of public names that a change of them shows in, from the packages' doors.

python docs/api.py            # prints the list
python docs/api.py --write    # writes docs/api.md and tests/public_api.txt
"""

import argparse
import inspect
import pkgutil
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import evogymcm

ROOT = Path(__file__).resolve().parents[1]
PAGE, LIST = ROOT / "docs" / "api.md", ROOT / "tests" / "public_api.txt"
ROOMS = (
    "evogymcm",
    "evogymcm.envs",
    "evogymcm.algos.learning",
    "evogymcm.algos.codesign",
    "evogymcm.algos.gaits",
    "evogymcm.algos.runs",
    "evogymcm.algos.analysis",
    "evogymcm.report",
    "evogymcm.fabrication",
    "evogymcm.studio",
    "evogymcm.testing",
    "evogymcm.sim",
)
MODULES = {"evogymcm.envs": ("evogymcm.envs.voxels",)}  # whose text is worth showing, without their members
INTRODUCTION = """\
---
search:
  boost: 0.5  # guides come first
---

# API

Every public name has one path, that of its room below; the modules where they are defined are private. Names are loaded
when they are first used: `import evogymcm` loads neither torch nor numba. Those of `evogymcm.algos.learning` and
`evogymcm.algos.runs` are in `evogymcm.algos` too.
"""


def names(room: str) -> list[str]:
    """Returns the public names of a room, functions and classes in alphabetical order."""
    return sorted(import_module(room).__all__, key=str.lower)


def home(room: str, name: str) -> str:
    """Returns the module that defines a public name."""
    module = getattr(getattr(import_module(room), name), "__module__", None)
    if module is not None and module.startswith("evogymcm"):
        return str(module)
    for info in pkgutil.walk_packages(evogymcm.__path__, "evogymcm."):  # data has no __module__
        if info.name != room and not info.name.endswith("__main__"):
            defined = re.search(rf"^(?:\w+, )*{name}\b.* = ", _source(info.name), re.MULTILINE)
            if defined:
                return info.name
    raise LookupError(f"{room}.{name}: no module defines it")


def page() -> str:
    """Returns the page in Markdown, for mkdocstrings."""
    parts = [INTRODUCTION]
    for room in ROOMS:
        parts += [f"## {room}\n", f"{(import_module(room).__doc__ or '').splitlines()[0]}\n"]
        for name in names(room):
            parts.append(f"::: {home(room, name)}.{name}\n    options: {{heading: {room}.{name}}}\n")
        for module in MODULES.get(room, ()):
            parts.append(f"::: {module}\n    options: {{members: []}}\n")
    return "\n".join(parts)


def listing() -> str:
    """Returns all public names, a line each, with the arguments that they take and the public members of classes."""
    return "".join(f"{line}\n" for room in ROOMS for name in names(room) for line in _lines(room, name))


def _source(module: str) -> str:
    spec = import_module(module).__spec__
    return Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin else ""


def _lines(room: str, name: str) -> list[str]:
    value, path = getattr(import_module(room), name), f"{room}.{name}"
    if not callable(value):
        return [path]
    lines = [f"{path}{_arguments(value)}"]
    if inspect.isclass(value):
        own = [kind for kind in value.__mro__ if kind.__module__.startswith("evogymcm")]
        members = {key: item for kind in reversed(own) for key, item in vars(kind).items() if not key.startswith("_")}
        for key, item in sorted(members.items()):
            item = item.__func__ if isinstance(item, classmethod | staticmethod) else item
            lines.append(f"{path}.{key}{_arguments(item) if inspect.isfunction(item) else ''}")
    return lines


def _arguments(value: Any) -> str:
    """The arguments with their defaults; of types, only that there are some."""
    init = getattr(value, "__init__", None)  # where it says more than a metaclass does
    try:
        signature = inspect.signature(init if hasattr(init, "__signature__") else value)
    except ValueError:
        return "(...)"
    bare = [p.replace(annotation=inspect.Parameter.empty) for p in signature.parameters.values() if p.name != "self"]
    text = str(signature.replace(parameters=bare, return_annotation=inspect.Signature.empty))
    return re.sub(r"<(?:function|class|factory)[^>]*>| at 0x[0-9a-f]+", "...", text)


def main() -> None:
    """Prints the list, or writes both files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write docs/api.md and tests/public_api.txt")
    if not parser.parse_args().write:
        print(listing(), end="")
        return
    PAGE.write_text(page(), encoding="utf-8")
    LIST.write_text(listing(), encoding="utf-8")


if __name__ == "__main__":
    main()
