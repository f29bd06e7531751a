"""The package as users get it: built, installed away from the checkout, and without its extras."""

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import evogymcm

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NAME = re.compile(r"[\w.-]+")  # of a distribution, at the start of a requirement
QUICK_START = """
import gymnasium as gym
import evogymcm as cm

assert len(cm.robots) > 0 and len(cm.tasks) >= 34
env = gym.make("evogymcm/BridgeWalker-v0", body=cm.robots["Walk_Bot"])
env.reset(seed=0)
env.action_space.seed(0)
for _ in range(3):
    _, _, _, _, info = env.step(env.action_space.sample())
assert info["com"].shape == (2,) and info["return"] != 0.0
"""
LEARN = """
from functools import partial
from evogymcm.algos import PPOConfig, train
from evogymcm.envs import SoftRobotEnv, parallel_env, population_env

make_env = partial(SoftRobotEnv, "Walker-v0", bodies="HHH/V.V", material="reactive")
result = train(make_env, PPOConfig(total_steps=16, num_worlds=4, rollout_steps=4, eval_interval=0))
assert result.finished
population_env("Walker-v0", ["HHH/V.V"]).rollout(2)
parallel_env("Walker-v0", ["HHH/V.V"]).reset(seed=0)
"""
IMPORT_ALL = """
import importlib, pkgutil
import evogymcm

for module in pkgutil.walk_packages(evogymcm.__path__, "evogymcm."):
    if not module.name.startswith("evogymcm.studio.page"):  # what the extra is for
        importlib.import_module(module.name)
"""
RENDER = """
from evogymcm.envs import Renderer, TaskEngine

try:
    Renderer(TaskEngine("Walker-v0", "HHH/V.V"))
except ImportError as error:
    assert "evogymcm[render]" in str(error)
else:
    raise AssertionError("the module was not blocked")
"""


def package_files():
    """Paths of the package's files, from the repository's root."""
    files = (path for path in (ROOT / "evogymcm").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(ROOT).as_posix() for path in files}


def run(*command, **options):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The source archive, and the wheel made of it."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    (source,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return source, wheel


@pytest.mark.slow
def test_archives_hold_the_package(archives):
    source, wheel = archives
    expected = package_files()
    assert {"evogymcm/py.typed", "evogymcm/robots.txt", "evogymcm/sim/worlds/Lifter-v0.txt"} <= expected
    with zipfile.ZipFile(wheel) as file:
        held = set(file.namelist())
        info = f"evogymcm-{evogymcm.__version__}.dist-info"
        assert held - {name for name in held if name.startswith(info)} == expected
        assert f"{info}/licenses/LICENSE" in held
        assert "evogymcm = evogymcm.__main__:main" in file.read(f"{info}/entry_points.txt").decode()
    with tarfile.open(source) as file:
        held = {name.partition("/")[2] for name in file.getnames()}
    others = {"README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "mkdocs.yml", "pyproject.toml"}
    assert expected | others <= held
    for folder in ("tests", "benchmarks", "docs", "examples", "scripts"):
        assert any(name.startswith(f"{folder}/") for name in held), folder


@pytest.mark.slow
def test_wheel_runs_away_from_the_checkout(archives, tmp_path):
    """In an environment of its own, which sees the present one's dependencies but not its evogymcm."""
    venv, outside = tmp_path / "venv", tmp_path / "outside"
    outside.mkdir()
    run(sys.executable, "-m", "venv", "--without-pip", venv)
    python = venv / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", archives[1])
    (site,) = venv.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    where = run(python, "-c", "import evogymcm; print(evogymcm.__file__)", cwd=outside, env=environment)
    assert Path(where.strip()).is_relative_to(venv)
    run(python, "-c", QUICK_START, cwd=outside, env=environment)
    assert evogymcm.__version__ in run(venv / "bin" / "evogymcm", "--version", cwd=outside, env=environment)
    assert "Walker-v0" in run(venv / "bin" / "evogymcm", "tasks", cwd=outside, env=environment)
    assert list(outside.iterdir()) == []


def distributions(requirements):
    """Normal names of the distributions that requirements name."""
    return {re.sub(r"[-_.]+", "-", NAME.match(requirement)[0]).lower() for requirement in requirements}


def extra_modules():
    """Top-level modules that only extras bring."""
    extras = set().union(*(distributions(names) for names in PROJECT["optional-dependencies"].values()))
    extras -= distributions(PROJECT["dependencies"]) | {"evogymcm"}
    return {
        module
        for module, owners in packages_distributions().items()
        if distributions(owners) & extras and not module.startswith("_")
    }


@pytest.mark.slow
def test_extras_are_optional(tmp_path):
    blocked = extra_modules()
    assert {"pygame", "imageio", "matplotlib", "stable_baselines3", "cma", "ribs", "plotly", "tensorboard"} <= blocked
    assert {"distributed", "nicegui", "ray", "wandb"} <= blocked  # their tests would be skipped in silence
    assert not blocked & {"numpy", "torch", "gymnasium", "numba", "torchrl", "tqdm", "tyro"}
    start = f"import sys\nsys.modules.update(dict.fromkeys({sorted(blocked)!r}))\n"
    run(
        sys.executable,
        "-c",
        start + QUICK_START + RENDER + LEARN + IMPORT_ALL,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_pages_say_which_versions_are_taken(page):
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    assert f"Python {PROJECT['requires-python'].removeprefix('>=')} or newer" in text
    for requirement in map(Requirement, PROJECT["dependencies"]):
        bounds = {each.operator: each.version for each in requirement.specifier}
        if requirement.name in {"gymnasium", "numba", "numpy", "pettingzoo", "torch", "torchrl"}:
            below = f" (below {bounds['<']})" if "<" in bounds else ""
            assert f"{requirement.name} {bounds['>=']}{below}" in text


def test_citation_and_changelog_are_of_this_version():
    yaml = pytest.importorskip("yaml")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == evogymcm.__version__
    assert citation["license"] == PROJECT["license"]
    titles = [work["title"] for work in citation["references"]]
    page = (ROOT / "docs" / "citation.md").read_text(encoding="utf-8")
    assert f"version = {{{evogymcm.__version__}}}," in page
    assert [title for title in titles[:2] if f"{{{title}}}" not in page] == []
    assert any("Evolution Gym" in title for title in titles)
    assert f"## {evogymcm.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
