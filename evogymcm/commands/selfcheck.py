"""`evogymcm selfcheck`: whether this machine computes the package's bits, and which part differs if not."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from evogymcm._messages import some
from evogymcm.commands._options import Bar

if TYPE_CHECKING:
    from evogymcm.testing import SelfCheck

DIFFERENT = 1  # exit status
_ABOUT = {
    "tanh": "C library: friction",
    "acos": "C library: orientation",
    "sin, cos": "C library: features of voxel policies",
    "springs": "springs and their limits",
    "contact": "floor and contact, without friction",
    "readings": "what is observed, without orientation",
    "friction": "contact as it is, takes tanh",
    "orientation": "takes acos",
}
DESCRIPTION = """Simulates a few env-steps of every task, always the same ones, and compares all bits with those that
came with the package: about a second, once the simulator is compiled. Where bits differ, the table says whether the
C library's functions do or the arithmetic does.

examples:
  evogymcm selfcheck
  evogymcm selfcheck --json > selfcheck.json    # for a report"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        json: print everything as one JSON object.
        write: store this machine's hashes in the package (for maintainers).
    """

    json: bool = False
    write: bool = False


def run(options: Options, arguments: Sequence[str]) -> int:
    """Compares, and returns the exit status: 1 where anything differs."""
    from evogymcm.envs._selfcheck import ENV_STEPS, N_SETTINGS, REFERENCE
    from evogymcm.envs.tasks import own_tasks
    from evogymcm.testing import selfcheck

    with Bar(len(own_tasks()) * N_SETTINGS * ENV_STEPS) as bar:
        check = selfcheck(progress=lambda done: bar.show(done, {}))
    if options.write:
        check.write()
        print(f"wrote {REFERENCE}: {len(check.differing())} of {len(check.parts)} hashes are new")
        return 0
    print(json.dumps(check.as_dict(), indent=1) if options.json else "\n".join(_table(check)))
    return 0 if check.is_equal else DIFFERENT


def _table(check: "SelfCheck") -> list[str]:
    lines = [f"{'part':20}  {'':9}  what it is"]
    for part in check.parts:
        if part.name in _ABOUT:
            lines.append(f"{part.name:20}  {'equal' if part.is_equal else 'DIFFERENT':9}  {_ABOUT[part.name]}")
    for kind, about in (("physics", "positions and velocities"), ("observations", "observations and rewards")):
        tasks = [part for part in check.parts if part.kind == kind and part.name not in _ABOUT]
        differing = [part.name for part in tasks if not part.is_equal]
        state = "DIFFERENT" if differing else "equal"
        lines.append(f"{f'{len(tasks)} tasks':20}  {state:9}  {about}{': ' * bool(differing)}{some(differing, 8)}")
    machines = (("here", check.machine), ("package", check.reference))
    texts = [f"{name:8} {', '.join(f'{key} {value}' for key, value in machine.items())}" for name, machine in machines]
    return [*lines, "", *texts, "", check.verdict]
