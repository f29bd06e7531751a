"""The whole page, how it is written, and the command."""

import base64
import json
import re
import shutil
import sys
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest

from evogymcm.__main__ import main
from evogymcm.algos import RunRecord
from evogymcm.algos.analysis import summarise
from evogymcm.algos.learning.threads import exploration
from evogymcm.report import make_report, write_report
from evogymcm.report.animations import animate, choose_scenes, gif_uri
from evogymcm.report.figures import curves
from evogymcm.report.sources import Arm, make_arms, read_source
from evogymcm.report.tables import codesign_scores, training_scores
from evogymcm.report.work import work_section
from tests.commands.tools import refused

HEADINGS = re.compile(r"<h2>(.*?)</h2>")
GIF = re.compile(r'src="data:image/gif;base64,([^"]+)"')


def text_of(page):
    """The page's own text, without plotly's program and without tags."""
    body = page[page.index("<body>") :]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", re.sub(r"<script.*?</script>", "", body, flags=re.DOTALL)))


def test_a_suite_of_experiment_a(suite):
    page = make_report([suite])
    assert HEADINGS.findall(page) == ["What this is made from", "Training", "Best designs in motion"]
    text = text_of(page)
    for shown in (
        "experiment A", "Walker-v0", "control-only, co-optimisation", "0, 1, 2", "6 planned, 6 finished",
        "1,000 env-steps", "Some Processor, 2 cores, 15.5 GiB, Linux x86_64", "torch 2.13.0", "0123abc",
        "2 h 1 min (last sitting); 3 min in the runs, added up",
    ):  # fmt: skip
        assert shown in text
    row = "co-optimisation 3 1,000 0.10 (0.00) 9.25 (0.25) 9.00 to 9.50 96.9% 9.75 (0.25) 9.50 to 10.00 10.25 (0.25)"
    assert f"{row} 9.55 (0.01)" in text
    assert "range of the seeds" in text
    assert "the run&#39;s folder is missing" in text


def test_curves_have_bands_and_the_papers_score(suite):
    arms = make_arms([read_source(suite)])
    figure = curves("Walker-v0", arms, "train")
    named = {trace.name: trace for trace in figure.data if trace.name}
    assert set(named) == {
        "control-only, mean of 3 seeds", "co-optimisation, mean of 3 seeds",
        "paper, control-only: 9.46", "paper, co-optimisation: 9.55",
    }  # fmt: skip
    np.testing.assert_allclose(named["co-optimisation, mean of 3 seeds"].y, [0.1, 9.75, 9.25])
    assert list(named["paper, co-optimisation: 9.55"].y) == [9.55, 9.55]
    assert named["paper, co-optimisation: 9.55"].line.dash == "dot"
    (upper,) = [trace for trace in figure.data if trace.fill == "tonexty" and trace.legendgroup == "co-optimisation"]
    np.testing.assert_allclose(upper.y, [0.1, 10.0, 9.5])


def test_real_runs_side_by_side(training, evolved, signals):
    (training / "reactive-0" / "signals.json").write_text(json.dumps(signals))
    page = make_report([training, evolved, training / "reactive-1"])
    (training / "reactive-0" / "signals.json").unlink()
    assert HEADINGS.findall(page) == [
        "What this is made from", "Training", "Co-design", "Best designs", "Evolution of designs", "Stiffness fields",
        "Signals of policies that set stiffness", "Best designs in motion",
    ]  # fmt: skip
    text = text_of(page)
    assert "Not recorded with these runs: processes." in text
    assert f"torch {version('torch')}" in text
    assert "64 env-steps for each body, at most 6 bodies in generations of 4" in text
    gifs = [base64.b64decode(found) for found in GIF.findall(page)]
    assert len(gifs) == 4
    assert all(gif.startswith(b"GIF8") and len(gif) <= 400_000 for gif in gifs)
    body = page[page.index("<body>") :]
    assert body.count('class="plotly-graph-div"') == body.count("Plotly.newPlot(") == 7


def test_animations_show_what_a_policy_would_do_without_noise(training):
    pytest.importorskip("pygame")
    scene = choose_scenes(make_arms([read_source(training)]))[0][0]
    with exploration(True):  # of whoever calls
        shown = animate(*scene)
    assert shown == animate(*scene)


def test_best_score_of_co_design_is_a_mean_of_steps(evolved):
    arms = make_arms([read_source(evolved)])
    figure = curves("Dart-v0", arms, "codesign")
    named = {trace.name: trace for trace in figure.data if trace.name}
    assert set(named) == {"reactive, seed 0", "invariant, mean of 2 seeds"}
    (reactive,) = [arm.runs[0] for arm in arms if arm.label == "reactive"]
    assert list(zip(named["reactive, seed 0"].x, named["reactive, seed 0"].y, strict=True)) == list(reactive.curve)
    assert all(trace.line.shape == "hv" for trace in figure.data)
    ends = [dict(run.curve) for arm in arms if arm.label == "invariant" for run in arm.runs]
    last = min(max(points) for points in ends)
    assert named["invariant, mean of 2 seeds"].x[-1] == last
    scores = [next(best for steps, best in sorted(points.items(), reverse=True) if steps <= last) for points in ends]
    assert named["invariant, mean of 2 seeds"].y[-1] == pytest.approx(np.mean(scores))


def test_robust_scores_stand_beside_the_papers_where_there_are_some():
    final = {"score": 2.0, "return": 3.0, "robust_score": 1.5, "spread": 0.25}
    told = {"kind": "train", "task": "Walker-v0", "finished": True, "curve": [[0, 0.0], [64, 2.0]], "final": final}
    best = {"index": 0, "fitness": 1.5, "robust_score": 1.75, "spread": 0.5}
    evolved = {"kind": "codesign", "task": "Walker-v0", "curve": [[64, 1.5]], "best": best}
    runs = [RunRecord.from_dict(row) for row in (told, {**told, "label": "plain", "final": {"score": 2.0}}, evolved)]
    arms = [Arm(run.label, "", (run,), {}) for run in runs]
    table = training_scores(arms, "")
    at = table.head.index("robust score")
    assert [row[at] for row in table.rows] == ["1.50 ± 0.25", ""]
    table = codesign_scores(arms, "")
    assert table.rows[0][table.head.index("robust score")] == "1.75 ± 0.50"
    assert "robust score" not in training_scores(arms[1:2], "").head


def test_work_stands_beside_the_score_and_who_is_on_the_front_of_both():
    def told(score, actuation, stiffness):
        return {"score": score, "actuation_work": actuation, "stiffness_work": stiffness,
                "net_actuation_work": actuation / 2, "net_stiffness_work": -stiffness}  # fmt: skip

    def trained(label, seed, *numbers):
        row = {"kind": "train", "task": "Walker-v0", "label": label, "seed": seed, "finished": True}
        return RunRecord.from_dict(row | {"curve": [[0, 0.0], [64, 2.0]], "final": told(*numbers)})

    rows = ({"index": i, "fitness": 9.0, "env_steps": 64} | told(2.5 - i, 1500, 0) for i in range(2))
    evolved = RunRecord.from_dict({"kind": "codesign", "task": "Walker-v0", "curve": [[64, 2.5]], "best": {"index": 0}})
    runs = {
        "plain": (trained("plain", 0, 1.0, 1000, 0), trained("plain", 1, 2.0, 3000, 0)),
        "reactive": (trained("reactive", 0, 3.0, 1500, 500), trained("reactive", 1, 1.0, 2500, 10)),
        "evolved": (replace(evolved, rows=tuple(rows)),),
    }
    arms = [Arm(label, "", own, {}) for label, own in runs.items()]
    means, front = work_section(arms).parts[1:]
    assert means.rows[0] == ["plain", "2", str(summarise([1.0, 2.0])), "2,000", "0", "1,000", "0"]
    assert means.rows[1][3:] == ["2,000", "255", "1,000", "-255"]
    assert [row[:4] for row in front.rows] == [
        ["reactive", "seed 0", "3.00", "2,000"],
        ["evolved", "design 0", "2.50", "1,500"],
        ["plain", "seed 0", "1.00", "1,000"],
    ]
    assert "3 of 6 are" in front.caption
    unmeasured = RunRecord.from_dict({"kind": "train", "task": "Walker-v0", "final": {"score": 2.0}})
    assert not work_section([Arm("plain", "", (unmeasured,), {})]).parts


def test_the_same_runs_give_the_same_page(evolved):
    assert make_report([evolved], animations=False) == make_report([evolved], animations=False)


def test_nothing_is_loaded_from_elsewhere(suite):
    page = make_report([suite], animations=False)
    without_program = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"""(?:src|href)=(?!"data:|"#)""", without_program)
    assert "@import" not in without_program
    assert "url(" not in without_program


def test_names_are_text_not_markup(suite):
    results = json.loads((suite / "results.json").read_text())
    results["machine"]["cpu"] = results["runs"][0]["arm"] = "<script>alert(1)</script>"
    (suite / "results.json").write_text(json.dumps(results))
    page = make_report([suite], animations=False)
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page


def test_a_report_is_written_whole_and_overwrites_only_when_told(suite, tmp_path, monkeypatch):
    out = tmp_path / "report.html"
    assert write_report([suite], out, animations=False) == out
    first = out.read_text()
    assert first.startswith("<!DOCTYPE html>")
    out.write_text("old")
    with pytest.raises(FileExistsError, match="set overwrite"):
        write_report([suite], out, animations=False)
    monkeypatch.setattr("evogymcm.report.page._render", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_report([suite], out, overwrite=True, animations=False)
    assert out.read_text() == "old"
    monkeypatch.undo()
    write_report([suite], out, overwrite=True, animations=False)
    assert out.read_text() == first
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", suite.name]


def test_wrong_files_are_refused(suite, tmp_path):
    with pytest.raises(ValueError, match="suffix must be"):
        write_report([suite], tmp_path / "report.pdf")
    with pytest.raises(ValueError, match="does not exist"):
        write_report([suite], tmp_path / "missing" / "report.html")


def test_without_plotly_the_extra_is_named(suite, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(ImportError, match=r"evogymcm\[report\]"):
        write_report([suite], tmp_path / "report.html")


def test_without_pygame_there_are_no_animations(training, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    page = make_report([training])
    assert not GIF.findall(page)
    assert "evogymcm[render]" in text_of(page)


def test_policies_that_cannot_be_shown_are_named(training, tmp_path):
    folder = tmp_path / "reactive-0"
    shutil.copytree(training / "reactive-0", folder)
    (folder / "final.pt").write_bytes(b"nonsense")
    assert "final.pt cannot be read" in text_of(make_report([folder]))
    record = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps(record | {"task": "Unknown-v0"}))
    shutil.copy(training / "reactive-0" / "final.pt", folder)
    assert "Unknown-v0" in text_of(make_report([folder])).split("Best designs in motion")[-1]
    (folder / "result.json").write_text(json.dumps(record | {"bodies": ["HVH/S.R", "HVH/SSR"]}))
    assert "do not name the one body" in text_of(make_report([folder]))


def test_a_run_of_the_command_line_is_shown(tmp_path, capsys):
    options = "--total-steps 32 --num-worlds 4 --rollout-steps 8 --minibatch 16 --hidden 8 --epochs 1 --eval-worlds 1"
    body = ["--body", "HVH/S.R", "--stiffness", "2,1,2/0.5,1,0.5"]
    main(["train", "Dart-v0", *body, "--run", str(tmp_path / "run"), *options.split()])
    main(["report", str(tmp_path / "run"), "--out", str(tmp_path / "report.html")])
    assert "report.html" in capsys.readouterr().out
    page = (tmp_path / "report.html").read_text()
    assert HEADINGS.findall(page) == ["What this is made from", "Training", "Best designs in motion"]
    assert len(GIF.findall(page)) == 1


def test_a_gif_is_thinned_out_until_it_is_small():
    frames = list(np.random.default_rng(0).integers(0, 256, (8, 60, 60, 3), np.uint8))
    whole, thin = gif_uri(frames), gif_uri(frames, 15_000)
    assert len(thin) <= 15_000 * 4 / 3 + 30 < len(whole)
    with pytest.raises(ValueError, match="more than 100 bytes"):
        gif_uri(frames, 100)


def test_the_command(suite, tmp_path, capsys, monkeypatch):
    out = tmp_path / "page.html"
    made = ["report", str(suite), "--out", str(out)]
    assert main([*made, "--no-animations"]) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    assert "in motion" not in out.read_text()
    assert "--overwrite" in refused(capsys, *made)
    assert main([*made, "--overwrite", "--no-animations"]) == 0
    for module in ("jinja2", "plotly.graph_objects"):
        monkeypatch.setitem(sys.modules, module, None)
        assert re.match(r"evogymcm: .*evogymcm\[report\]\n$", refused(capsys, *made, "--overwrite"))
