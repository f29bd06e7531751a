"""`evogymcm report`: a report on run folders, as one HTML file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from evogymcm.commands._options import checking_arguments

DESCRIPTION = """Makes one HTML file of training, co-design or suite folders.

examples:
  evogymcm report runs/first
  evogymcm report runs/first runs/second --out compared.html"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        runs: folder of a training run, a co-design run, a suite, or several runs; they are compared side by side.
        out: the file to write.
        overwrite: replace an existing file.
        no_animations: leave out the designs in motion.
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN", help_behavior_hint="")] = ()
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("report.html")
    overwrite: bool = False
    no_animations: bool = False


def run(options: Options, arguments: Sequence[str]) -> int:
    """Writes the report and returns the exit status."""
    from evogymcm.report.page import prepare, write_page

    with checking_arguments():
        try:
            sources = prepare(options.runs, options.out, overwrite=options.overwrite)
        except FileExistsError:
            raise ValueError(f"out: {options.out} exists (--overwrite)") from None
    write_page(sources, options.out, animations=not options.no_animations)
    print(f"wrote {options.out}")
    return 0
