"""Runs a recipe: the Python of the section of docs/other-libraries.md that names a script of this folder.

python tests/clients/recipe.py NAME
"""

import dataclasses
import re
import sys
import types
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "other-libraries.md"
BLOCK = re.compile(r"^```python.*\n(?P<code>(?:.*\n)*?)```$", re.MULTILINE)
SMALLER = {"total_timesteps=100_000": "total_timesteps=512"}  # budgets of the page, and those of its tests


def blocks(name):
    """Returns the code of the section."""
    sections = PAGE.read_text(encoding="utf-8").split("\n## ")
    (section,) = (section for section in sections if f"`tests/clients/{name}.py`" in section)
    return [match["code"] for match in BLOCK.finditer(section)]


def main(name):
    """Runs it, with small budgets and short episodes."""
    from evogymcm.envs import tasks

    tasks._REGISTRY["Walker-v0"] = dataclasses.replace(tasks.tasks["Walker-v0"], time_limit=25)
    module = types.ModuleType("recipe")
    sys.modules["recipe"] = module  # dataclasses and pickles look their module up
    for number, code in enumerate(blocks(name)):
        for large, small in SMALLER.items():
            code = code.replace(large, small)
        exec(compile(code, f"{PAGE.name}, {name}, block {number}", "exec"), module.__dict__)


if __name__ == "__main__":
    main(sys.argv[1])
