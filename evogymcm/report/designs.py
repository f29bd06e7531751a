"""Sections on designs: how bodies evolved, and their stiffness fields."""

from collections.abc import Sequence

import numpy as np

from evogymcm.algos.analysis import mean_stiffness
from evogymcm.algos.codesign.design import Design
from evogymcm.algos.runs.record import Row, RunRecord
from evogymcm.body import Body
from evogymcm.report.figures import fitness_by_generation
from evogymcm.report.lineage import MOST, ancestors, lineage_svg
from evogymcm.report.parts import Figure, Fold, Note, Part, Picture, Pictures, Section
from evogymcm.report.pictures import body_svg, stiffness_ramp, stiffness_svg, types_svg
from evogymcm.report.sources import Arm
from evogymcm.report.tables import tasks_of

_AVERAGED = 5  # best designs of each run in an average


def design_sections(arms: Sequence[Arm]) -> list[Section]:
    """Returns the sections on the designs of co-design runs."""
    runs = [(arm, run) for task in tasks_of(arms, "codesign") for arm in arms for run in arm.of(task, "codesign")]
    runs = [(arm, run) for arm, run in runs if run.designs]
    return [_best(runs), _evolution(arms, runs), _stiffness(arms)] if runs else []


def _body(row: Row) -> Body:
    return Body(row["body"], row.get("connections"))


def _best(runs: Sequence[tuple[Arm, RunRecord]]) -> Section:
    """The best design of each run."""
    pictures = []
    for arm, run in runs:
        best = run.ranked()[0]
        caption = f"{arm.title(run)}: {best['fitness']:z.2f}"
        pictures.append(Picture(body_svg(_body(best)), caption))
    caption = "The best design of each run with its fitness, the score of its stored policy."
    return Section("Best designs", [Pictures("", [Picture(types_svg())]), Pictures("", pictures, caption)])


def _evolution(arms: Sequence[Arm], runs: Sequence[tuple[Arm, RunRecord]]) -> Section:
    """Fitness over generations and family trees."""
    parts: list[Part] = []
    for task in tasks_of(arms, "codesign"):
        figure = fitness_by_generation(task, arms)
        if figure.data:
            text = "Every body that was trained, with its latest fitness; arms are set side by side in a generation."
            parts.append(Figure(f"{task}, all bodies", figure, text))
    note = (
        "Bodies by the generation in which they were proposed, best first, with their latest fitness; lines lead from"
        f" parents to mutants, and the best body's line is red. At most {MOST} bodies of a generation are shown, and"
        " those of the line."
    )
    trees: list[Part] = []
    for arm, run in runs:
        if len(run.designs) > 1:
            line = ancestors(run.designs, run.ranked()[0]["index"])[::-1]
            text = "Line of the best: " + " → ".join(_step(run.designs[index]) for index in line) + "."
            tree = Pictures("", [Picture(lineage_svg(run))], text, is_wide=True)
            trees.append(Fold(arm.title(run), [tree], is_open=not trees))
    return Section("Evolution of designs", [*parts, Note(note), *trees] if trees else parts)


def _step(row: Row) -> str:
    return f"no. {row['index']} ({'not told' if row.get('fitness') is None else format(row['fitness'], 'z.2f')})"


def _stiffness(arms: Sequence[Arm]) -> Section:
    """Fields of the best designs, and their averages; only where they were searched."""
    parts: list[Part] = []
    for task in tasks_of(arms, "codesign"):
        for arm in arms:
            runs = arm.of(task, "codesign")
            if any(row.get("stiffness") is not None for run in runs for row in run.designs.values()):
                parts.append(_fields(f"{task}, {arm.label}", runs))
    if not parts:
        return Section("Stiffness fields")
    note = "Factors on the spring constants, from 0.5 to 2. An average is the geometric mean of each cell over the"
    note += f" {_AVERAGED} best designs of every run, as far as they have a voxel there."
    return Section("Stiffness fields", [Note(note), Pictures("", [Picture(stiffness_ramp())]), *parts])


def _fields(title: str, runs: Sequence[RunRecord]) -> Pictures:
    """Maps of the best designs of an arm's runs, and of their averages."""
    pictures = []
    chosen: dict[tuple[int, int], list[tuple[Body, np.ndarray]]] = {}  # by shape
    for run in runs:
        for rank, row in enumerate(run.ranked()[:_AVERAGED]):
            body, field = run.design(row)
            chosen.setdefault(body.shape, []).append((body, field))
            if rank == 0:
                seed = "" if run.seed is None else f"seed {run.seed}, "
                caption = f"{seed}best design (no. {row.get('index', '?')}): {row['fitness']:z.2f}"
                pictures.append(Picture(stiffness_svg(field, body.occupancy), caption))
    for designs in chosen.values():
        if len(designs) > 1:
            found = mean_stiffness([Design(*design) for design in designs], least=1, with_intervals=False)
            hints = [f"{count} of {len(designs)} designs" for count in found.count[found.count > 0]]
            caption = f"average over {len(designs)} of the best designs"
            pictures.append(Picture(stiffness_svg(found.mean, found.count > 0, hints), caption))
    return Pictures(title, pictures)
