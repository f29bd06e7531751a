"""The same bits everywhere: `evogymcm selfcheck` on this machine, on lesser processors, without the JIT."""

import json
import os
import platform
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from evogymcm.__main__ import main
from evogymcm.envs import _selfcheck
from evogymcm.envs import tasks as task_package
from evogymcm.testing import selfcheck

WITHOUT_JIT = """
import json, math
import numpy as np
from evogymcm.sim.kernels import springs
from evogymcm.testing import selfcheck

def differing():
    check = selfcheck(tasks=())
    return check.differing(), check.verdict

def other(function):  # as another C library has it: the last bit is another, except where there is no choice
    def rounded(x):
        y = function(x)
        return math.nextafter(y, math.inf) if abs(y) > 1e-8 and abs(y) != 1.0 else y
    return rounded

results = [[list(part) for part in selfcheck(tasks=()).parts]]
tanh, acos = math.tanh, math.acos
math.tanh = other(tanh)
results.append(differing())
math.acos = other(acos)
results.append(differing())
math.tanh, math.acos = tanh, acos
springs.sqrt = lambda x: np.nextafter(np.sqrt(x), np.inf)
results.append(differing())
print(json.dumps(results))
"""


def run(*arguments, **environment):
    command = [sys.executable, "-W", "ignore", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | environment)
    assert done.stdout, done.stderr
    return json.loads(done.stdout)


def test_this_machine_computes_the_bits_of_the_package(capsys):
    status = main(["selfcheck", "--json"])
    out, err = capsys.readouterr()
    check = json.loads(out)
    assert {part["name"] for part in check["parts"] if part["kind"] == "physics"} > set(task_package.own_tasks())
    assert all(part["expected"] for part in check["parts"])
    assert all(part["is_equal"] for part in check["parts"] if part["kind"] == "arithmetic")
    assert "report" not in check["verdict"]  # anything else is explained by another C library
    assert status == (0 if check["is_equal"] else 1)
    assert "100%" in err


def test_the_part_that_differs_is_named():
    # As plain Python runs, the kernels' arithmetic and library calls can be exchanged.
    plain, other_tanh, other_library, other_arithmetic = run("-c", WITHOUT_JIT, NUMBA_DISABLE_JIT="1")
    assert plain == [list(part) for part in selfcheck(tasks=()).parts]
    here = selfcheck(tasks=()).differing()
    assert set(other_tanh[0]) - set(here) == {"tanh", "friction"} - set(here)
    assert set(other_library[0]) - set(here) == {"tanh", "acos", "friction", "orientation"} - set(here)
    assert "Only functions outside the package differ (tanh, acos" in other_library[1]
    assert set(other_arithmetic[0]) - set(here) == {"springs", "contact", "friction"} - set(here)
    assert other_arithmetic[1].startswith("The arithmetic differs (springs, contact)")


def test_written_bits_are_compared_from_then_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_selfcheck, "REFERENCE", tmp_path / "selfcheck.json")
    monkeypatch.setattr(task_package, "_MODULES", (task_package.climbing,))  # a second less
    assert main(["selfcheck"]) == 1
    assert main(["selfcheck", "--write"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["selfcheck.json"]
    assert main(["selfcheck"]) == 0
    assert "All bits are the package's." in capsys.readouterr().out
    written = json.loads(_selfcheck.REFERENCE.read_text(encoding="utf-8"))
    written["physics"]["Climber-v1"] = "0" * 16
    _selfcheck.REFERENCE.write_text(json.dumps(written), encoding="utf-8")
    assert main(["selfcheck"]) == 1
    shown = capsys.readouterr().out
    assert "DIFFERENT  positions and velocities: Climber-v1\n" in shown
    assert "are the package's, but Climber-v1 differ. Please report" in shown


def test_tasks_that_are_not_the_packages_are_refused():
    with pytest.raises(ValueError, match=r"got 'Wolker-v0', allowed are the package's: .*Walker-v0"):
        selfcheck(["Wolker-v0"])


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="these are processors of another kind")
def test_lesser_processors_compute_the_same_bits(tmp_path):
    def check(processor):
        environment = {"NUMBA_CPU_NAME": processor, "NUMBA_CACHE_DIR": str(tmp_path / processor)}
        return run("-m", "evogymcm", "selfcheck", "--json", **environment)

    processors = ("haswell", "nehalem")  # with and without fused operations; both without AVX-512
    with ThreadPoolExecutor() as threads:  # they compile all kernels
        found = list(threads.map(check, processors))
    ours = [part.found for part in selfcheck().parts]
    for processor, theirs in zip(processors, found, strict=True):
        assert theirs["machine"]["compiled_for"] == processor
        assert [part["found"] for part in theirs["parts"]] == ours
