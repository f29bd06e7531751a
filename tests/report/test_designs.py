"""Pictures of bodies and fields, and family trees."""

import re

import numpy as np

from evogymcm.algos.runs import RunRecord
from evogymcm.body import Body
from evogymcm.envs.render import palette
from evogymcm.report.designs import design_sections
from evogymcm.report.lineage import ancestors, lineage_svg, shown_by_generation
from evogymcm.report.pictures import body_svg, css, stiffness_svg
from evogymcm.report.sources import make_arms, read_source


def individual(index, parent, generation, fitness):
    body = "HV/SR"
    return {"index": index, "parent": parent, "generation": generation, "fitness": fitness, "body": body}


def run_of(*rows):
    curve = ((1, max(row["fitness"] for row in rows)),)
    return RunRecord("codesign", "Walker-v0", "fixed", "invariant", seed=0, finished=True, curve=curve, rows=rows)


def test_a_body_has_a_square_of_its_colour_for_each_voxel():
    body = Body("HH./SRV")
    svg = body_svg(body)
    for code in (1, 2, 3, 4):
        squares = re.search(f'd="([^"]*)" fill="{css(palette.type_color(code))}"', svg)[1].count("h1v1h-1z")
        assert squares == np.count_nonzero(body.grid == code)


def test_stiffness_map():
    svg = stiffness_svg(np.array([[0.5, 2.0], [1.0, 1.0]]), np.array([[True, True], [False, True]]))
    assert re.findall(r">(\d\.\d\d)<", svg) == ["0.50", "2.00", "1.00"]
    assert css(palette.stiffness_colors(np.array([2.0]))[0]) in svg


def test_the_line_of_the_best():
    run = run_of(individual(0, None, 0, 1.0), individual(1, 0, 1, 0.5), individual(2, 1, 3, 2.0))
    assert ancestors(run.designs, 2) == [2, 1, 0]
    assert ancestors(run_of(individual(3, 7, 1, 1.0)).designs, 3) == [3]  # its parent is not recorded
    svg = lineage_svg(run)
    assert svg.count('<path d="M') - 3 * 6 == 2  # links; each body has 4 types and 2 marks
    assert [int(found) for found in re.findall(r">generation (\d)<", svg)] == [0, 1, 3]


def test_of_large_generations_the_best_and_the_line_are_shown():
    rows = [individual(i, None, 0, float(-i)) for i in range(20)]
    run = run_of(*rows, individual(20, 19, 1, 5.0))
    shown = shown_by_generation(run, ancestors(run.designs, 20))
    assert [row["index"] for row in shown[0]] == [*range(8), 19]
    assert "and 11 more" in lineage_svg(run)


def test_sections_of_real_runs(evolved):
    arms = make_arms([read_source(evolved)])
    best, evolution, stiffness = design_sections(arms)
    legend, pictures = best.parts
    assert len(legend.pictures) == 1
    assert len(pictures.pictures) == 3
    assert [part.kind for part in evolution.parts] == ["figure", "note", "fold", "fold", "fold"]
    assert sum(len(trace.x) for trace in evolution.parts[0].figure.data) == 18
    (fields,) = [part for part in stiffness.parts if part.kind == "pictures" and part.title]
    assert fields.title == "Dart-v0, invariant"  # the other arm has no fields
    assert [picture.caption.split(":")[0] for picture in fields.pictures[:2]] == [
        f"seed {run.seed}, best design (no. {run.ranked()[0]['index']})"
        for arm in arms if arm.label == "invariant" for run in arm.runs
    ]  # fmt: skip
    assert fields.pictures[2].caption == "average over 10 of the best designs"
