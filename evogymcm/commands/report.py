"""`evogymcm report`: what run folders hold, as one HTML file."""

import argparse
from pathlib import Path
from typing import Any

from evogymcm.commands._errors import checking_arguments


def add_parser(subparsers: Any) -> None:
    """Adds the command to a parser."""
    parser = subparsers.add_parser("report", help="make an HTML report of training, co-design or suite folders")
    parser.add_argument(
        "runs",
        nargs="+",
        type=Path,
        metavar="RUN",
        help="folder of a training run, a co-design run, a suite, or several runs; arms are compared side by side",
    )
    parser.add_argument("--out", type=Path, default=Path("report.html"), metavar="FILE", help="default: report.html")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")
    parser.add_argument("--no-animations", action="store_true", help="leave out the designs in motion")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Writes the report and returns the exit status.

    Raises:
        UsageError: A folder or the file's name cannot be used, or a package of the extra `report` is missing.
    """
    from evogymcm.report.page import prepare, write_page

    with checking_arguments():
        try:
            sources = prepare(args.runs, args.out, overwrite=args.overwrite)
        except FileExistsError:
            raise ValueError(f"out: {args.out} exists (--overwrite)") from None
    write_page(sources, args.out, animations=not args.no_animations)
    print(f"wrote {args.out}")
    return 0
