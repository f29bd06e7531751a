"""`evogymcm selfcheck`: whether this machine computes the package's bits, and which part differs if not."""

import argparse
import json
from typing import TYPE_CHECKING, Any

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
_DESCRIPTION = """Simulates every task for a moment, always the same, and compares every bit with what the package was
released with: about a second, once the simulator is compiled. Where bits differ, the table says whether the
C library's functions do or the arithmetic does."""


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser(
        "selfcheck",
        help="compare this machine's bits with the package's",
        description=_DESCRIPTION,
        epilog="examples:\n  evogymcm selfcheck\n  evogymcm selfcheck --json > selfcheck.json    # for a report",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print everything as one JSON object")
    parser.add_argument("--write", action="store_true", help="make this machine's bits the package's (for maintainers)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compares, and returns the exit status: 1 where anything differs."""
    from evogymcm.envs._selfcheck import ENV_STEPS, N_SETTINGS, REFERENCE
    from evogymcm.envs.tasks import own_tasks
    from evogymcm.testing import selfcheck

    with Bar(len(own_tasks()) * N_SETTINGS * ENV_STEPS) as bar:
        check = selfcheck(progress=lambda done: bar.show(done, {}))
    if args.write:
        check.write()
        print(f"wrote {REFERENCE}: {len(check.differing())} of {len(check.parts)} hashes are new")
        return 0
    print(json.dumps(check.as_dict(), indent=1) if args.json else "\n".join(_table(check)))
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
