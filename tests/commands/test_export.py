"""`evogymcm export` of bodies and of designs in runs."""

import csv
from pathlib import Path

import pytest

from evogymcm.__main__ import main
from evogymcm.algos import RunRecord
from tests.commands.tools import refused

RUNS = Path(__file__).resolve().parents[1] / "data" / "runs"
NO_MESHES = "--no-meshes"


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def table(folder="sheet"):
    with Path(folder, "sheet.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_body_with_its_stiffness_is_written(capsys):
    pytest.importorskip("trimesh")
    assert main(["export", "HHS/V.R", "--stiffness", "2,2,0.5/1,1,1.5", "--size", "20"]) == 0
    out = capsys.readouterr().out
    assert "HHS/V.R: 60 x 40 mm" in out
    assert "wrote sheet/horizontal-S2.00.stl" in out
    assert [row["stiffness"] for row in table()] == ["2", "2", "0.5", "1", "1.5"]
    assert "sheet exists" in refused(capsys, "export", "HHS", NO_MESHES)
    assert main(["export", "Walk_Bot", NO_MESHES, "--overwrite"]) == 0
    assert sorted(path.name for path in Path("sheet").iterdir()) == ["sheet.csv", "sheet.svg"]


def test_arguments_that_cannot_be_used_are_told(capsys):
    for arguments, message in [
        (["XYZ"], "neither rows of"),
        (["HHH", "--stiffness", "3"], "allowed are 0.5 to 2"),
        (["HHH", "--size", "0"], "size: got 0"),
        (["HHH", "--number", "1"], "number: got 1, 'HHH' is no run"),
        (["HHH", "--calibration", "none.csv"], "none.csv cannot be read"),
    ]:
        assert message in refused(capsys, "export", *arguments, NO_MESHES)
    assert list(Path().iterdir()) == []


def test_designs_of_runs_are_written_with_their_stiffness(capsys):
    for arguments, body, stiffness in [
        (["codesign-prescribed"], "S../HR.", 3 * [1.5]),
        (["codesign-prescribed", "--number", "0"], "SHR/VH.", 5 * [1.5]),
        (["codesign-prescribed/policy-0000.pt", "--stiffness", "2"], "SHR/VH.", 5 * [2.0]),
        (["train-fields", "--number", "1"], "VHH/S.R", [0.5, 0.5, 0.5, 1.0, 1.5]),
        (["train-command"], "HHH/V.V", 5 * [1.0]),
    ]:
        assert main(["export", str(RUNS / arguments[0]), *arguments[1:], NO_MESHES, "--overwrite"]) == 0
        out = capsys.readouterr().out
        assert f"{body}: 30 x 20 mm" in out
        assert ("set by the policy" in out) == ("train-command" in arguments)
        assert [float(voxel["stiffness"]) for voxel in table()] == stiffness
    searched = RunRecord.read(RUNS / "codesign-invariant")
    assert main(["export", str(searched.path), NO_MESHES, "--overwrite"]) == 0
    body, field = searched.design(searched.best)
    assert [float(voxel["stiffness"]) for voxel in table()] == pytest.approx(field[body.occupancy].tolist(), rel=1e-5)
    for name, number, message in [
        ("codesign-invariant", ["--number", "7"], "has the designs 0 to 2"),
        ("train-fields", [], "has 2 bodies"),
        ("train-fields", ["--number", "2"], "counted from 0"),
    ]:
        assert message in refused(capsys, "export", RUNS / name, *number, NO_MESHES)
