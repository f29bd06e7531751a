"""Runs of designs and videos: what is found in the folder, what may be named, what is drawn."""

import io
import json
import shutil
import zipfile
from pathlib import Path

import imageio.v3 as imageio
import pytest

from evogymcm.studio.drawing import Drawing
from evogymcm.studio.exports import film, zip_sheet
from evogymcm.studio.runs import Runs
from evogymcm.studio.sessions import Studio
from evogymcm.studio.store import TERRAIN, Design, Store, check_policy


@pytest.fixture(name="store")
def _store(tmp_path):
    return Store(tmp_path / "robots")


def make_run(folder, policy=None):
    """A folder that looks like a run; nothing reads what is in it here."""
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    if policy:
        (folder / policy).write_bytes(b"")


def test_policies_are_those_of_the_folder_and_those_given(store, tmp_path):
    id = store.add(Design("Ant"))
    for name, policy in (
        ("train-1", "checkpoint.pt"),
        ("train-2", None),
        ("train-10", "final.pt"),
        ("other", "final.pt"),
    ):
        make_run(store.runs(id) / name, policy)
    for name in ("a", "b"):
        make_run(tmp_path / name / "first", "final.pt")
    runs = Runs(store, [tmp_path / "a" / "first", tmp_path / "b" / "first"])
    assert runs.names(id) == ["train-1", "train-2", "train-10"]
    assert {
        "ant/train-1": "Ant: Training 1",
        "ant/train-10": "Ant: Training 10",
        "given:first": "Run first",
        "given:first (2)": "Run first (2)",
    }.items() <= runs.policies("Walker-v0", "invariant").items()
    assert "ant/train-2" not in runs.policies("Walker-v0", "invariant")
    assert runs.policy("sine") == ("sine", 0)
    assert runs.policy("ant/train-2") == ("sine", 0)  # it has none yet
    path, version = runs.policy("ant/train-1")
    assert Path(path).name == "checkpoint.pt"
    (store.runs(id) / "train-1" / "final.pt").write_bytes(b"")
    assert Path(runs.policy("ant/train-1")[0]).name == "final.pt"
    assert version > 0
    assert runs.policy("given:first (2)")[0] == str((tmp_path / "b" / "first").resolve())
    for gone in ("ant/train-3", "ant/train-1/policy-0001", "nobody/train-1", "given:second"):
        assert check_policy(gone) == gone
        with pytest.raises(ValueError, match=r"policy: "):
            runs.policy(gone)
    with pytest.raises(ValueError, match="there is no"):
        Runs(store, [tmp_path / "c"])


@pytest.mark.parametrize(
    "policy",
    [
        "",
        "walk",
        "../train-1",
        "ant/../train-1",
        "ant/train-0",
        "ant/train-1/final",
        "ant/train-1/../x",
        "/etc/x",
        "given:a/b",
        3,
    ],
)
def test_nothing_else_is_a_policy(store, policy):
    with pytest.raises(ValueError, match="policy: got"):
        check_policy(policy)
    (store.folder / "designs" / "bad.json").write_text(json.dumps({"design": {"body": "H"}, "policy": policy}))
    with pytest.raises(ValueError, match="policy: got"):
        store.load("bad")


def test_a_run_that_is_a_link_is_not_followed(store, tmp_path):
    id = store.add(Design("Ant"))
    make_run(tmp_path / "secret", "final.pt")
    store.runs(id).mkdir()
    (store.runs(id) / "train-1").symlink_to(tmp_path / "secret")
    with pytest.raises(ValueError, match="out of the folder"):
        Runs(store).policy("ant/train-1")


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_robot_in_its_terrain_is_filmed(store, tmp_path, suffix):
    id = store.add(Design("Ant", task=TERRAIN, drawing=Drawing.of("HHH/V.V")))
    studio = Studio(store)
    path = film(studio.open(id).wanted(), tmp_path / f"ant{suffix}", steps=8, view="stiffness")
    pictures = imageio.imread(path, index=None)
    assert pictures.shape[:3] == (4, 320, 640)
    assert (pictures[0] != pictures[-1]).any()
    studio.close()
    shutil.rmtree(store.folder)


def test_a_sheet_for_fabrication_is_one_file():
    drawing = Drawing.of("HHH/V.V", [[2, 1, 1], [1, 1, 1]])
    with zipfile.ZipFile(io.BytesIO(zip_sheet(drawing.body(), drawing.stiffness, size=20.0, classes=3))) as archive:
        names = archive.namelist()
        assert {"sheet.svg", "sheet.csv"} <= set(names)
        assert sum(name.endswith(".stl") for name in names) == 3
        assert b"60" in archive.read("sheet.svg")
    with pytest.raises(ValueError, match="size"):
        zip_sheet(drawing.body(), drawing.stiffness, size=0.0)
