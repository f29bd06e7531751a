"""The documentation's pages: their code runs and prints what they show, and what they name exists."""

import contextlib
import importlib
import io
import os
import pkgutil
import re
import shutil
import subprocess
import sys
import types
from importlib.metadata import entry_points
from itertools import pairwise
from pathlib import Path

import pytest

from tests.clients.recipe import SMALLER as OF_RECIPES
from tests.registries import shorten

ROOT = Path(__file__).resolve().parents[1]
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
FENCE = re.compile(r"^```(?P<info>.+)\n(?P<content>(?:.*\n)*?)```$", re.MULTILINE)
OUTPUT = 'text title="Output"'
OPTIONAL = re.compile(r'python title="Run by the tests where ([\w.]+) is installed"')
KINDS = {"python", "sh", "bibtex", OUTPUT}  # python runs, sh is for a terminal
SMALLER = {  # budgets of the pages, and those of the tests
    "total_steps=200_000": "total_steps=64, num_worlds=16, rollout_steps=4",
    "total_steps=50_000": "total_steps=64, num_worlds=16, rollout_steps=4",
    "total_steps=100_000, num_worlds=16": "total_steps=32, num_worlds=4, rollout_steps=8, eval_interval=0",
    "SearchConfig(), population=8, budget=32": "SearchConfig(rounds=1), population=2, budget=2",
    "total_steps=500_000, num_worlds=64": "total_steps=64, num_worlds=16, rollout_steps=4",
    "total_steps=500_000, num_worlds=512, minibatch=2048": "total_steps=64, num_worlds=16, rollout_steps=4",
    "GaitConfig(env_steps=12_000": "GaitConfig(env_steps=2_000",
    **OF_RECIPES,
}
LONG = {"codesign", "evolution", "other-libraries", "results"}  # these take more than some seconds
WHOLE = {"tasks"}  # pages that show how long an episode is; on the others those of Walker-v0 are 25 env-steps long


def is_installed(module):
    """Whether a module can be imported, with all that it needs."""
    try:
        importlib.import_module(module)
    except ImportError:
        return False
    return True


def blocks_of(page):
    """Yields the code of each Python block of a page, and the output that the page shows below it, or None."""
    fences = [(match["info"], match["content"]) for match in FENCE.finditer(PAGES[page])]
    assert {info for info, _ in fences if not OPTIONAL.fullmatch(info)} <= KINDS
    for (info, code), (next_info, shown) in pairwise([*fences, ("", "")]):
        assert (info, next_info) not in {("sh", OUTPUT), (OUTPUT, OUTPUT)}
        optional = OPTIONAL.fullmatch(info)
        if info == "python" or (optional and is_installed(optional[1])):
            yield code, shown if next_info == OUTPUT else None


WITH_CODE = [page for page in PAGES if list(blocks_of(page))]


@pytest.mark.usefixtures("own_registries")
@pytest.mark.parametrize("page", [pytest.param(page, marks=[pytest.mark.slow] * (page in LONG)) for page in WITH_CODE])
def test_code_runs_and_prints_what_is_shown(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("page")  # dataclasses look their module up
    monkeypatch.setitem(sys.modules, "page", module)
    if page not in WHOLE:
        shorten("Walker-v0", 25)
    for number, (code, shown) in enumerate(blocks_of(page)):
        for large, small in SMALLER.items():
            code = code.replace(large, small)
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, f"{page}.md, block {number}", "exec"), module.__dict__)
        if shown is not None:
            assert printed.getvalue().rstrip() == shown.rstrip(), code


def test_pages_with_code_are_these():
    expected = {
        "baselines",
        "codesign",
        "concepts",
        "custom-tasks",
        "fabrication",
        "from-evogym",
        "from-jax-evogym",
        "gaits",
        "gymnasium",
        "index",
        "learning",
        "other-libraries",
        "pettingzoo",
        "reports",
        "results",
        "tasks",
        "torchrl",
        "work",
    }
    assert expected <= set(WITH_CODE)


def test_budgets_that_are_made_smaller_are_there():
    text = "".join(PAGES.values())
    assert [large for large in SMALLER if large not in text] == []


def test_pages_are_in_the_navigation_and_link_to_files_that_exist():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page, text in PAGES.items():
        assert f": {page}.md\n" in navigation
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
            assert (ROOT / "docs" / target).exists(), f"{page}: {target}"


def test_search_works_from_disk_and_pages_load_nothing_from_elsewhere():
    yaml = pytest.importorskip("yaml")
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    plugins = [name for plugin in config["plugins"] for name in ([plugin] if isinstance(plugin, str) else plugin)]
    assert {"search", "offline"} <= set(plugins)
    (script,) = config["extra"]["polyfills"]
    assert "iframe-worker" in script  # by this name the plugin knows that it need not fetch its own
    assert (ROOT / "docs" / script).is_file()


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome")
def test_search_box_finds_pages_of_the_site_opened_from_disk(tmp_path):
    pytest.importorskip("mkdocs")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(site)]
    subprocess.run(command, cwd=ROOT, check=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"})
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=8000", "--dump-dom"]
    page = f"{(site / 'index.html').as_uri()}?q=hardness"
    done = subprocess.run([BROWSER, *options, page], capture_output=True, text=True, check=True, timeout=600)
    found = re.findall(r'href="([^"]*)" class="md-search-result__link"', done.stdout)
    assert any(target.startswith(f"{(site / 'fabrication.html').as_uri()}") for target in found)


def test_functions_of_the_journeys_exist():
    names = set(re.findall(r"`(evogymcm(?:\.\w+)+)`", PAGES["architecture"]))
    assert len(names) > 30
    for name in names:
        pkgutil.resolve_name(name)  # raises where there is none


def test_commands_of_the_pages_exist(capsys):
    (script,) = entry_points(group="console_scripts", name="evogymcm")
    main = script.load()
    text = "".join(PAGES.values()) + (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"(?:python -m evogymcm|^evogymcm|`evogymcm) (\w+)", text, re.MULTILINE))
    assert {"codesign", "gait", "report", "selfcheck", "tasks", "train", "warmup", "watch"} <= named
    lines = re.findall(r"(?:python -m evogymcm|^evogymcm|`evogymcm) (\w+)([^#`\n]*)", text, re.MULTILINE)
    for command in named:
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0, command
        shown = capsys.readouterr().out
        assert f"evogymcm {command}" in shown
        options = {option for name, rest in lines if name == command for option in re.findall(r"--[\w.-]+", rest)}
        assert all(re.search(rf"(?<![\w-]){re.escape(option)}(?![\w.-])", shown) for option in options), options


def test_every_public_name_of_evogym_has_a_place_on_its_page():
    named = set(re.findall(r"\w+", " ".join(re.findall("`([^`]+)`", FENCE.sub("", PAGES["from-evogym"])))))
    utils = "BASELINE_ENV_NAMES VOXEL_TYPES Pair Timer draw get_full_connectivity get_uniform has_actuator hashable"
    worlds = """
        EvoWorld WorldObject from_json load_from_json from_array load_from_array add_from_json add_from_array add_object
        remove_object translate_object move_object pretty_print translate set_pos get_structure get_connections get_pos
        rename get_name copy
    """
    simulator = """
        EvoSim set_action step reset revert get_time pos_at_time vel_at_time object_pos_at_time object_vel_at_time
        object_orientation_at_time get_actuator_indices get_dim_action_space
    """
    viewer = """
        EvoViewer render set_resolution set_view_size set_pos set_target_rps show_debug_window hide_debug_window close
        track_objects set_tracking_settings
    """
    environments = """
        EvoGymBase BenchmarkBase PackageBase ClimbBase StairsBase ShapeBase GoalBase VOXEL_SIZE DATA_PATH sim world
        default_viewer get_pos_com_obs get_vel_com_obs get_relative_pos_obs get_ort_obs get_floor_obs get_ceil_obs
    """
    names = f"{utils} sample_robot is_connected {worlds} {simulator} {viewer} {environments}".split()
    assert [name for name in names if name not in named] == []
