"""Arguments of earlier versions, in the words of today."""

import sys
from collections.abc import Sequence

from evogymcm.algos.runs.older import of_arm


def in_present_words(arguments: Sequence[str]) -> list[str]:
    """Returns arguments of `codesign` with `--arm` and `--prescribed` as they are written today, and says so on stderr.

    Raises:
        ValueError: There was no such arm.
    """
    rest = [part for item in arguments for part in (item.split("=", 1) if item.startswith("--") else [item])]
    old: dict[str, str] = {}
    for name in ("arm", "prescribed"):
        while f"--{name}" in rest:
            place = rest.index(f"--{name}")
            old[name] = "".join(rest[place + 1 : place + 2])
            del rest[place : place + 2]
    if not old:
        return list(arguments)
    now = of_arm(old.get("arm", "reactive"), old.get("prescribed", "1.0"), ["--search"])
    words = ["--material", now["material"]]
    words += now["search"] or ([] if now["stiffness"] == 1.0 else ["--stiffness", now["stiffness"]])
    if not now["search"]:  # whose options had no effect then
        for place in [i for i, item in enumerate(rest) if item.startswith("--search.")][::-1]:
            del rest[place : place + 2]
    said = " ".join(f"--{name} {value}" for name, value in old.items())
    print(f"evogymcm: {said} is of before and will go; write {' '.join(words)}", file=sys.stderr)
    return [*rest, *words]
