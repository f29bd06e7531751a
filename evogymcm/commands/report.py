"""`evogymcm report`: what run folders hold, as one HTML file."""

import argparse
import sys
from pathlib import Path
from typing import Any


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
        ValueError: A folder or the file's name cannot be used.
    """
    from evogymcm.report import write_report

    try:
        out = write_report(args.runs, args.out, overwrite=args.overwrite, animations=not args.no_animations)
    except FileExistsError:
        raise ValueError(f"out: {args.out} exists (--overwrite)") from None
    except ImportError as error:
        print(f"evogymcm: {error}", file=sys.stderr)
        return 2
    print(f"wrote {out}")
    return 0
