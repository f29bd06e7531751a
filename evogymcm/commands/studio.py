"""`evogymcm studio`: draw a robot in the browser, and watch it move and learn."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from evogymcm.commands._options import checking_arguments

DESCRIPTION = """Opens a page in the browser to draw a robot, paint its stiffness, and watch it move and learn.

It listens on 127.0.0.1 only, and answers only to a browser that has the key of the address shown.

examples:
  evogymcm studio
  evogymcm studio my-robots --policy runs/first
  evogymcm studio --port 8700 --no-browser"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        folder: where designs and runs are kept; made where there is none.
        policy: folders of training runs elsewhere whose policies may move robots too.
        port: to listen on; 0 takes a free one.
        no_browser: only show the address.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")] = Path("evogymcm-studio")
    policy: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN", help_behavior_hint="")] = ()
    port: int = 8420
    no_browser: bool = False


def run(options: Options, arguments: Sequence[str]) -> int:
    """Serves the page until it is interrupted, and returns the exit status."""
    from evogymcm.studio.server import serve

    with checking_arguments():
        serve(options.folder, options.port, policies=options.policy, show=not options.no_browser, tell=_tell)
    return 0


def _tell(address: str) -> None:
    print(f"the studio is at {address}\nCtrl-C ends it", flush=True)
