"""`evogymcm codesign` from end to end, on tiny budgets; the cost that it says before it starts."""

import json
import re
import shlex
import signal
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import tyro

from evogymcm.__main__ import main
from evogymcm.algos import BodyPPOConfig
from evogymcm.algos.codesign import CodesignConfig, SearchConfig, codesign, cost_of
from evogymcm.algos.codesign.parallel import codesign_in
from evogymcm.commands import _options
from evogymcm.commands.codesign import Options, config_of, in_present_words
from tests.commands.tools import refused

PPO = ["--ppo.total-steps", "64", "--ppo.num-worlds", "4", "--ppo.rollout-steps", "8", "--ppo.hidden", "8"]
TINY = ["--shape", "2", "3", "--population", "3", "--budget", "4", *PPO]
SEARCHING = ["--material", "invariant", "--search.rounds", "2"]
SMALL = BodyPPOConfig(total_steps=64, num_worlds=4, rollout_steps=8, hidden=8, eval_interval=32)


@pytest.mark.parametrize(
    "arguments",
    [["--material", "reactive"], SEARCHING, ["--material", "invariant", "--stiffness", "1.5"]],
    ids=["reactive", "searching", "stiff"],
)
def test_a_run_from_end_to_end(sprint, arguments, capsys, tmp_path):
    assert main(["codesign", sprint, *arguments, *TINY]) == 0
    out, err = capsys.readouterr()
    run = tmp_path / "runs" / f"Sprint-v0-codesign-{arguments[1]}-seed0"
    config, result = (json.loads((run / name).read_text()) for name in ("config.json", "result.json"))
    assert (config["task"], config["material"], config["shape"]) == (sprint, arguments[1], [2, 3])
    assert result["finished"]
    assert result["n_designs"] == 4
    best = result["best"]
    assert best["body"] in out
    assert float(re.search(r"^score +(\S+)", out, re.MULTILINE)[1]) == pytest.approx(best["fitness"], abs=6e-4)
    said = int(re.search(r"at most ([\d,]+) env-steps", out)[1].replace(",", ""))
    assert result["env_steps"] <= said
    if arguments != SEARCHING:  # there, proposals that fall behind are not scored twice
        assert result["env_steps"] == said
    assert ("1.50" in out.split("stiffness:")[1]) == ("1.5" in arguments)
    assert f"best={best['fitness']:.3f}" in err
    pytest.importorskip("matplotlib")
    rows = [json.loads(line) for line in (run / "curve.jsonl").read_text().splitlines()]
    latest = {f"policy-{row['index']:04}.pt": row for row in rows}
    assert len(latest) == 4
    for name, row in [("", best), ("codesign.pt", best), *latest.items()]:  # each on its own body, with its stiffness
        main(["watch", "--policy", str(run / name), "--width", "64", "--height", "32", "--out", "one.png"])
        assert capsys.readouterr().out.splitlines()[-1] == f"{row['body']}: 12 env-steps, score {row['fitness']:.3f}"


def test_a_stopped_run_goes_on_to_the_same_result(sprint, capsys, monkeypatch, tmp_path):
    command = ["codesign", sprint, *SEARCHING, *TINY]
    main([*command, "--run", "whole"])
    assert "--overwrite" in refused(capsys, *command, "--run", "whole")

    def interrupt(bar, done, numbers):
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(_options.Bar, "show", interrupt)
        assert main([*command, "--run", "parts"]) == 130
    again = capsys.readouterr().out.splitlines()[-1].strip()
    assert again == f"evogymcm {shlex.join(command)} --run parts --resume"
    assert main(shlex.split(again)[1:]) == 0
    whole, parts = ((tmp_path / name / "curve.jsonl").read_text() for name in ("whole", "parts"))
    assert whole == parts


def test_the_robust_score_is_told_where_there_are_several_starts(sprint, capsys, tmp_path):
    assert main(["codesign", sprint, *TINY, "--run", "run", "--eval-starts", "2", "--selection", "robust"]) == 0
    best = json.loads((tmp_path / "run" / "result.json").read_text())["best"]
    assert best["fitness"] == best["robust_score"]
    told = f"robust  {best['robust_score']:.3f} ± {best['spread']:.3f}: the score from 2 starts that differ by 1e-6 m"
    assert told in capsys.readouterr().out


def test_a_limit_in_env_steps_ends_the_run(sprint, capsys, tmp_path):
    assert main(["codesign", sprint, *TINY, "--max-env-steps", "10", "--run", "run"]) == 0
    assert "ends with the generation in which 10 env-steps are reached" in capsys.readouterr().out
    assert json.loads((tmp_path / "run" / "result.json").read_text())["n_designs"] == 3  # the first generation


def test_a_file_of_a_world_is_a_task(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("floor.txt").write_text("F" * 30)
    run = Path("runs/floor-codesign-reactive-seed0")
    run.mkdir(parents=True)
    (run / "note").touch()
    assert f"run: {run} exists and is not a run folder" in refused(capsys, "codesign", "floor.txt", *TINY)


def test_nothing_is_touched_where_an_argument_is_bad(sprint, capsys, tmp_path):
    command = ["codesign", sprint, *TINY]
    for wrong, message in [
        (["codesign", "Nope-v0"], "Walker-v0"),
        ([*command, "--budget", "0"], "budget"),
        ([*command, "--rungs", "0.5"], "keep"),
        ([*command, "--ppo.network", "mlp"], "voxel"),
        (["codesign", "Climber-v0", *TINY, "--shape", "5", "9"], "does not fit"),
        ([*command, *SEARCHING, "--search.noise", "pink"], "multiplicative"),
        ([*command, *SEARCHING, "--search.proposal", "cma"], "at least 2"),
        ([*command, "--search"], "needs material 'invariant'"),
        ([*command, "--arm", "active"], "allowed are reactive, fixed, invariant, prescribed"),
    ]:
        said = " ".join(refused(capsys, *wrong).replace("│", " ").split())  # out of its box
        assert message in said
    assert list(tmp_path.iterdir()) == []


def test_the_same_wish_gives_the_same_settings(sprint, tmp_path):
    for arguments, config in (
        ([], CodesignConfig(task=sprint)),
        (["--ppo.total-steps", "50000"], CodesignConfig(task=sprint, ppo=BodyPPOConfig(total_steps=50_000))),
        (
            [*SEARCHING, "--rungs", "0.5", "--keep", "0.5", "--ppo.sharing", "shared"],
            CodesignConfig(
                task=sprint,
                material="invariant",
                rungs=(0.5,),
                keep=(0.5,),
                search=SearchConfig(rounds=2),
                ppo=BodyPPOConfig(sharing="shared"),
            ),
        ),
    ):
        assert parse([sprint, *arguments]) == config
    own = BodyPPOConfig(total_steps=50_000)  # a wish that says nothing of worlds and sharing
    assert (own.num_worlds, own.minibatch, own.eval_interval, own.sharing) == (16, 128, 10_000, "independent")
    three = own.of_bodies(3)
    assert (three.total_steps, three.num_worlds, three.minibatch, three.eval_worlds) == (150_000, 48, 128, None)
    assert replace(own, sharing="shared").of_bodies(3).minibatch == 3 * 128

    main(["codesign", sprint, *TINY, "--run", "run"])  # and a run goes on from either
    config = CodesignConfig(
        task=sprint,
        shape=(2, 3),
        population=3,
        budget=4,
        ppo=BodyPPOConfig(total_steps=64, num_worlds=4, rollout_steps=8, hidden=8),
    )
    assert codesign_in(tmp_path / "run", config).finished


def parse(arguments):
    return config_of(tyro.cli(Options, args=arguments, config=(tyro.conf.FlagCreatePairsOff,)), arguments)


def test_words_of_before_are_told_what_they_are_now(capsys):
    for old, now in (
        ("--arm reactive --search.rounds 2", "--material reactive"),
        ("--arm=fixed --prescribed 1.5 --search.rounds=2", "--material invariant"),
        ("--arm prescribed --prescribed=1.5", "--material invariant --stiffness 1.5"),
        ("--seed 3 --arm invariant --search.rounds 2", "--material invariant --search --search.rounds 2 --seed 3"),
    ):
        arguments = in_present_words(["Walker-v0", *old.split()])
        assert parse(arguments) == parse(["Walker-v0", *now.split()])
        assert now.split(" --search.")[0] in capsys.readouterr().err
    assert in_present_words(["Walker-v0", *SEARCHING]) == ["Walker-v0", *SEARCHING]
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"material": "invariant", "search": SearchConfig(rounds=2, candidates=2)},
        {"rungs": (0.25, 0.5), "keep": (0.5, 0.5)},
        {"method": "random", "material": "invariant"},
        {"ppo": replace(SMALL, total_steps=70, eval_interval=0, sharing="shared")},
    ],
    ids=["plain", "searching", "halving", "random", "rounded"],
)
def test_the_cost_is_what_a_run_takes(sprint, options):
    config = CodesignConfig(**{"task": sprint, "shape": (2, 3), "population": 4, "budget": 6, "ppo": SMALL} | options)
    cost, result = cost_of(config), codesign(config)
    if not config.search:
        assert cost.total == result.env_steps
        assert cost.search == cost.finetuning == 0
        return
    assert result.env_steps <= cost.total
    searched = [row for row in result.rows if row["event"] == "search"]
    spared = 12 * config.search.rounds * len(searched)  # at most one scoring by itself a round and survivor
    assert result.env_steps >= cost.total - spared
    assert np.isclose(cost.total, sum(asdict(cost).values()))
