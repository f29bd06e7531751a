"""A report in a browser: everything is drawn, nothing is complained about, and the page fits its window."""

import html
import json
import re
import shutil
import subprocess

import pytest

from evogymcm.report import write_report

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--enable-logging=stderr", "--v=0",
    "--virtual-time-budget=10000", "--hide-scrollbars", "--window-size=1280,900",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)  # fmt: skip
# A headless window is at least 500 pixels wide, so the page is shown in a frame. It tells the page around it what it is
# like, since files may not look into each other.
PROBE = """<script>
addEventListener("load", () => document.querySelectorAll("details").forEach((fold) => { fold.open = true; }));
addEventListener("load", () => setTimeout(() => {
  const plots = [...document.querySelectorAll(".plotly-graph-div")];
  parent.postMessage({
    width: innerWidth,
    overflow: document.documentElement.scrollWidth - innerWidth,
    plots: plots.length,
    drawn: plots.filter((plot) => plot.querySelector(".main-svg")).length,
    tooWide: plots.filter((plot) => plot.querySelector(".main-svg")?.getBoundingClientRect().right > innerWidth).length,
    broken: [...document.images].filter((image) => !image.naturalWidth).length,
  }, "*");
}, 1000));
</script></body>"""
FRAME = """<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,"><body><pre></pre><script>
addEventListener("message", (event) => { document.querySelector("pre").textContent = JSON.stringify(event.data); });
</script><iframe src="page.html" style="border: 0; width: WIDTHpx; height: 5000px"></iframe></body>"""

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome")]


def look_at(folder, page, width):
    """Opens a page in a frame, and returns what the probe found and what the console said."""
    (folder / "page.html").write_text(page.replace("</body>", PROBE), encoding="utf-8")
    (folder / "frame.html").write_text(FRAME.replace("WIDTH", str(width)), encoding="utf-8")
    command = [BROWSER, *OPTIONS, f"--user-data-dir={folder / 'profile'}", "--dump-dom", f"file://{folder}/frame.html"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    found = json.loads(html.unescape(re.search("<pre>(.*?)</pre>", done.stdout)[1]))
    return found, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.parametrize("width", [1280, 400])
def test_a_report_is_drawn(training, evolved, suite, signals, tmp_path, width):
    shutil.copytree(training, tmp_path / "training")
    for seed in range(2):  # one of the two is folded up at first
        (tmp_path / "training" / f"reactive-{seed}" / "signals.json").write_text(json.dumps(signals))
    out = write_report([suite, tmp_path / "training", evolved], tmp_path / "report.html")
    page = out.read_text(encoding="utf-8")
    found, console = look_at(tmp_path, page, width)
    assert console == []
    n_plots = page.count('class="plotly-graph-div"')
    assert n_plots == 12
    expected = {"width": width, "overflow": 0, "plots": n_plots, "drawn": n_plots, "tooWide": 0, "broken": 0}
    assert found == expected


def test_the_probe_notices_what_is_wrong(tmp_path):
    page = """<!DOCTYPE html><body><div class="plotly-graph-div"></div><div style="width: 900px">wide</div>
    <img src="data:image/gif;base64,AAAA"><script>nonsense();</script></body>"""
    found, console = look_at(tmp_path, page, 400)
    assert (found["plots"], found["drawn"], found["broken"]) == (1, 0, 1)
    assert found["overflow"] > 400
    assert any("nonsense is not defined" in line for line in console)
