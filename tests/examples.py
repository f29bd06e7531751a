"""The example scripts as modules."""

import importlib.util
import re
import sys
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py"))


def shown(name):
    """An example as the README shows it: without its check."""
    source = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    return re.sub(r"^def check\(\).*?^(?=if __name__)", "", source, flags=re.MULTILINE | re.DOTALL)


def load_example(name):
    """The module of an example."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
