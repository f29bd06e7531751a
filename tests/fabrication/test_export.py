"""Sheets for fabrication: drawing, table and meshes against sizes and numbers worked out by hand."""

import csv
import io
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from evogymcm import Body
from evogymcm.fabrication import Calibration, Sheet, export_design, read_calibration
from evogymcm.fabrication.export import check_out

ROOT = Path(__file__).resolve().parents[2]
SVG, INKSCAPE = "{http://www.w3.org/2000/svg}", "{http://www.inkscape.org/namespaces/inkscape}"
BODY = Body("HSS/S.V/RSS")
FIELD = [[2.0, 1.0, 1.1], [1.0, 1.0, 0.5], [1.0, 0.6, 1.0]]  # in five classes: 0.5, 0.71, 1, 1.41, 2
# S of 0.6 is nearer to 0.5 than to 0.71 in its logarithm: 0.5 * 2 ** 0.25 = 0.595 lies between.
MATERIALS = {"rigid-S1.00": 1, "soft-S1.00": 4, "soft-S0.71": 1, "horizontal-S2.00": 1, "vertical-S0.50": 1}


def layers(drawing):
    return {layer.get("id"): layer for layer in ElementTree.fromstring(drawing).findall(f"{SVG}g")}


def rows_of(table):
    return list(csv.DictReader(io.StringIO(table)))


def test_the_drawing_has_its_true_size_and_a_layer_for_each_material():
    drawing = Sheet(BODY, FIELD, size=12.5).drawing()
    page = ElementTree.fromstring(drawing)
    assert (page.get("width"), page.get("height"), page.get("viewBox")) == ("37.5mm", "37.5mm", "0 0 37.5 37.5")
    found = layers(drawing)
    squares = {name: layer.findall(f"{SVG}rect") for name, layer in found.items()}
    assert {name: len(rects) for name, rects in squares.items() if rects} == MATERIALS
    assert [*found][-3:] == ["marks", "cuts", "labels"]
    assert all(layer.get(f"{INKSCAPE}groupmode") == "layer" for layer in found.values())
    rects = [rect for found_of in squares.values() for rect in found_of]
    assert {(rect.get("width"), rect.get("height")) for rect in rects} == {("12.5", "12.5")}
    (vertical,) = squares["vertical-S0.50"]
    assert (vertical.get("x"), vertical.get("y")) == ("25", "12.5")  # row 1, column 2, from the top
    assert sorted(text.text for text in found["labels"]) == sorted(["2.00", "0.50", "0.71"] + 5 * ["1.00"])
    assert len({found[name].get("fill") for name in MATERIALS}) == 5
    assert found["marks"][0].get("d") == "M2.5 9.375l7.5 0M35.625 15l0 7.5"  # along H's lower edge, V's right one


def test_neighbours_that_are_not_joined_are_cut_apart():
    joined = Body("HSS/SSS")
    kept = [pair for pair in joined.connections.T.tolist() if pair not in ([0, 1], [1, 4])]
    cut = Body(joined.grid, np.transpose(kept))
    assert layers(Sheet(cut).drawing())["cuts"][0].get("d") == "M10 0l0 10M10 10l10 0"
    assert len(layers(Sheet(joined).drawing())["cuts"]) == 0


def test_the_table_says_place_and_material_of_each_voxel():
    rows = rows_of(Sheet(BODY, FIELD, size=20).table())
    assert [(row["row"], row["column"]) for row in rows] == [(str(r), str(c)) for r, c in np.argwhere(BODY.occupancy)]
    assert list(rows[0].values()) == ["0", "0", "horizontal", "2", "horizontal-S2.00", "2", "0", "40"]
    assert list(rows[6].values()) == ["2", "1", "soft", "0.6", "soft-S0.71", "0.707107", "20", "0"]


def test_a_calibration_is_read_between_its_rows_for_each_type(tmp_path):
    file = tmp_path / "silicone.csv"
    head = "# measured\ntype, stiffness, modulus_kpa, mixing_ratio\n"
    file.write_text(f"{head}soft,0.5,100,0.1\nsoft,1,300,0.2\n\n,0.5,10,1\n,2,40,4")
    rows = rows_of(Sheet(BODY, FIELD).table(read_calibration(file)))
    told = {row["material"]: (float(row["modulus_kpa"]), float(row["mixing_ratio"])) for row in rows}
    share = (2**-0.5 - 0.5) / 0.5
    assert told == {
        "horizontal-S2.00": (40, 4),
        "vertical-S0.50": (10, 1),
        "rigid-S1.00": (20, 2),  # a third of the way from 0.5 to 2
        "soft-S1.00": (300, 0.2),
        "soft-S0.71": (pytest.approx(100 + 200 * share, rel=1e-5), pytest.approx(0.1 + 0.1 * share, rel=1e-5)),
    }
    example = Sheet(BODY, FIELD).table(read_calibration(ROOT / "examples" / "calibration.csv"))
    assert rows_of(example)[1]["infill_percent"] == "20"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"has the columns \[\], expected 'stiffness'"),
        ("stiffness\n1", "has the columns"),
        ("S,modulus\n1,2", "has the columns"),
        ("stiffness,modulus,modulus\n1,2,2", "has the columns"),
        ("stiffness,modulus", "has no rows"),
        ("stiffness,modulus\n1,hard", "got '1,hard', expected numbers"),
        ("stiffness,modulus\n1,inf", "got '1,inf'"),
        ("stiffness,modulus\n1", "got '1'"),
        ("stiffness,modulus\n1,2\n1,3", "must rise from row to row, got 1, 1"),
        ("type,stiffness,modulus\nwood,1,2", "got type 'wood', allowed are rigid"),
        ("type,stiffness,modulus\nsoft,0.5,2\nsoft,2,2", "no row for type 'rigid'"),
        ("stiffness,modulus\n0.5,2\n1,2", "reaches from 0.5 to 1; the design has 2"),
    ],
)
def test_calibrations_that_do_not_serve_are_refused(text, message, tmp_path):
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=f"calibration: .*{message}"):
        export_design(BODY, FIELD, tmp_path / "sheet", calibration=file, meshes=False)
    assert not (tmp_path / "sheet").exists()


def test_sheets_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"calibration: .*missing\.csv cannot be read"):
        read_calibration(tmp_path / "missing.csv")
    bad = {"size": 0, "depth": -1.0, "classes": 1, "stiffness": [[1.0]]}
    for name, value in bad.items():
        with pytest.raises(ValueError, match=f"{name}: got"):
            Sheet(BODY, **{name: value})
    with pytest.raises(ValueError, match="classes: got 51, at most 50"):
        Sheet(BODY, classes=51)
    assert len({f"{0.5 * 4 ** (i / 49):.2f}" for i in range(50)}) == 50  # names of as many are different
    with pytest.raises(ValueError, match=r"out: the folder .* does not exist"):
        export_design(BODY, out=tmp_path / "no" / "sheet", meshes=False)


def test_classes_are_even_in_the_logarithm_and_the_nearest_one_counts():
    field = np.array([[0.5, 0.59, 0.6, 2.0]])
    assert Sheet(Body("HHHH"), field, classes=5).class_stiffness[0] == pytest.approx([0.5, 0.5, 2**-0.5, 2.0])
    assert Sheet(Body("HHHH"), field, classes=2).class_stiffness[0] == pytest.approx([0.5, 0.5, 0.5, 2.0])


def test_meshes_are_closed_and_have_the_volume_of_their_voxels(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    from evogymcm.fabrication.meshes import material_meshes

    meshes = material_meshes(Sheet(BODY, FIELD, size=20, depth=5))
    assert {name: mesh.volume for name, mesh in meshes.items()} == pytest.approx(
        {name: n * 20 * 20 * 5 for name, n in MATERIALS.items()}
    )
    assert all(mesh.is_watertight and mesh.is_winding_consistent for mesh in meshes.values())
    np.testing.assert_allclose(meshes["vertical-S0.50"].bounds, [[40, 20, 0], [60, 40, 5]])
    assert material_meshes(Sheet(Body("HH")))["horizontal-S1.00"].vertices.shape == (12, 3)  # one solid
    # Voxels that touch at a corner, or are not joined, are two.
    for body, area in [(Body("SH/HS"), 2 * 600), (Body("SSH", [[1], [2]]), 2 * 600), (Body("SSH"), 1000)]:
        soft = material_meshes(Sheet(body))["soft-S1.00"]
        assert soft.is_watertight
        assert (soft.volume, soft.area) == (pytest.approx(2000), pytest.approx(area))
    ring = Body("SSS/S.S/SSH", Body("SSS/S.S/SSH").connections[:, 1:])  # cut open between the first two
    solid = material_meshes(Sheet(ring))["soft-S1.00"]
    assert solid.is_watertight
    assert solid.area == pytest.approx(7 * 200 + 100 * (7 * 4 - 2 * 5))

    files = export_design(BODY, FIELD, tmp_path / "sheet", size=20, depth=5)
    assert {file.name for file in files} == {"sheet.svg", "sheet.csv", *(f"{name}.stl" for name in MATERIALS)}
    assert {file.name for file in (tmp_path / "sheet").iterdir()} == {file.name for file in files}
    loaded = trimesh.load(tmp_path / "sheet" / "soft-S1.00.stl")
    assert loaded.volume == pytest.approx(4 * 2000)


def test_only_an_earlier_sheet_is_replaced_and_as_a_whole(tmp_path):
    out = tmp_path / "sheet"
    export_design(BODY, FIELD, out, meshes=False)
    (out / "soft-S2.00.stl").write_text("of another design")
    with pytest.raises(FileExistsError, match="set overwrite"):
        export_design("HHH", out=out, meshes=False)
    files = export_design("HHH", out=out, meshes=False, overwrite=True)
    assert sorted(out.iterdir()) == sorted(files)
    assert "HHH" in files[0].read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["sheet"]
    (out / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="something else than a sheet"):
        check_out(out, overwrite=True)


def test_calibrations_can_be_made_without_a_file():
    calibration = Calibration(["modulus"], {"": [(0.5, 1.0), (2.0, 4.0)]})
    assert calibration.of("soft", 1.25) == (2.5,)
