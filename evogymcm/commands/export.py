"""`evogymcm export`: a design as a sheet for fabrication."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import arg

from evogymcm.commands._options import checking_arguments, read_stiffness

if TYPE_CHECKING:  # numba is loaded when the command runs, not for its help
    import numpy as np

    from evogymcm.body import Body

DESCRIPTION = """Writes a sheet for fabrication: a drawing at true scale (SVG), a table of voxels (CSV), meshes (STL).

A calibration is a CSV file with a column "stiffness" and other columns of numbers, such as modulus and infill; the
table of voxels then has these for each voxel.

examples:
  evogymcm export HHH/V.V --stiffness 2,2,2/0.5,1,0.5 --size 20
  evogymcm export runs/evolved --calibration silicone.csv --out best
  evogymcm export runs/evolved --number 17 --classes 3 --no-meshes"""


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        design: rows of voxels (HHH/S.R), a robot's name or a file (.npz, .npy, .txt, .json); or the folder of a run:
            the best design of co-design, the body of a training run.
        number: of a run, another design (co-design) or body (training, counted from 0).
        stiffness: a number, or numbers in rows like the body's (2,2,2/0.5,1,0.5).
        size: edge of a voxel, mm.
        depth: how far voxels extend out of the plane, mm.
        classes: number of classes into which stiffness is put, spread evenly in its logarithm from 0.5 to 2.
        calibration: CSV file with a column "stiffness" and others that the table is to have for each voxel.
        out: folder to write into.
        no_meshes: leave out the meshes, which need the extra "export".
        overwrite: replace an earlier sheet in the folder.
    """

    design: Annotated[tyro.conf.Positional[str], arg(metavar="DESIGN")]
    number: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the best, or the only one)")] = None
    stiffness: Annotated[str, arg(metavar="FIELD", help_behavior_hint="(default: the design's, or 1)")] = ""
    size: Annotated[float, arg(metavar="MM")] = 10.0
    depth: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: a voxel's edge)")] = None
    classes: Annotated[int, arg(metavar="N")] = 5
    calibration: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    out: Annotated[Path, arg(metavar="FOLDER")] = Path("sheet")
    no_meshes: bool = False
    overwrite: bool = False


def run(options: Options, arguments: Sequence[str]) -> int:
    """Writes the sheet and returns the exit status."""
    with checking_arguments():
        from evogymcm.fabrication import export_design

        body, field, is_reactive = _design(options)
        given = read_stiffness([options.stiffness] if options.stiffness else [], [body])
        files = export_design(
            body,
            given[0] if given else field,
            options.out,
            size=options.size,
            depth=options.depth,
            classes=options.classes,
            calibration=options.calibration,
            meshes=not options.no_meshes,
            overwrite=options.overwrite,
        )
    if is_reactive and not given:
        print("stiffness is set by the policy in every step; the sheet has 1 everywhere (--stiffness says otherwise)")
    print(f"{body.text}: {body.cols * options.size:g} x {body.rows * options.size:g} mm")
    for file in files:
        print(f"wrote {file}")
    return 0


def _design(options: Options) -> "tuple[Body, np.ndarray | None, bool]":
    """Returns the body meant by DESIGN, its stiffness (None: 1 everywhere), and whether a policy sets that."""
    from evogymcm.algos.runs.folder import CONFIG, TABLE
    from evogymcm.body import as_body

    path, number = Path(options.design), options.number
    of_design = re.fullmatch(r"policy-(\d+)\.pt", path.name)
    if of_design and path.is_file():  # as `watch` takes them
        path, number = path.parent, int(of_design[1])
    if any((path / name).is_file() for name in (CONFIG, TABLE)):
        return _of_run(path, number)
    if number is not None:
        raise ValueError(f"number: got {number}, {options.design!r} is no run's folder, which has several designs")
    return as_body(options.design), None, False


def _of_run(path: Path, number: int | None) -> "tuple[Body, np.ndarray | None, bool]":
    """Returns a design of a run, by default the best of co-design or the only one of training."""
    import numpy as np

    from evogymcm.algos.runs.record import RunRecord
    from evogymcm.body import as_body

    run = RunRecord.read(path)
    if run.kind == "codesign":
        designs = run.designs
        if not run.ranked():
            raise ValueError(f"design: {path} has no trained design yet")
        number = run.ranked()[0].get("index", 0) if number is None else number
        if number not in designs:
            raise ValueError(f"number: got {number}, {path} has the designs {min(designs)} to {max(designs)}")
        return *run.design(designs[number]), run.material == "reactive"
    if len(run.bodies) != 1 and number is None:
        raise ValueError(f"number: needed, {path} has {len(run.bodies)} bodies")
    number = number or 0
    if not 0 <= number < len(run.bodies):
        raise ValueError(f"number: got {number}, {path} has {len(run.bodies)} bodies, counted from 0")
    body, stiffness = as_body(run.bodies[number]), run.stiffness
    if isinstance(stiffness, list | tuple):
        stiffness = stiffness[number]
    field = None if stiffness is None else np.where(body.occupancy, stiffness, 1.0)
    return body, field, run.material == "reactive"
