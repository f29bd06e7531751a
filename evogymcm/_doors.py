"""The doors of packages: public names, each imported from its module when it is first used."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def door(
    package: str, modules: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Returns what a package calls `__getattr__`, `__dir__` and `__all__`.

    So the names of a package have one path each, and a package of plain data does not load torch with it.

    Args:
        package: its name.
        modules: the public names in each of its modules (names relative to the package, or absolute).
    """
    homes = {name: module for module, names in modules.items() for name in names}
    names = sorted(homes)

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        return getattr(import_module(home if home.startswith("evogymcm.") else f"{package}.{home}"), name)

    return get, names.copy, names
