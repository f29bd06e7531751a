"""Checks that the lowest versions which pyproject.toml states are those installed here: else they have not been tried.

Names given as arguments are left out.
"""

import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WRONG = [
    f"{requirement.name}: {found} is installed, {each} is stated"
    for requirement in map(Requirement, PROJECT["dependencies"])
    if requirement.name not in sys.argv[1:]
    for found in [version(requirement.name)]
    for each in requirement.specifier
    if each.operator == ">=" and Version(each.version) != Version(found)
]
if WRONG:
    sys.exit("These are not the lowest versions:\n" + "\n".join(WRONG))
