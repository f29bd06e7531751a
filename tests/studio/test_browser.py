"""The studio in a browser, as its user has it: drawn with mouse or finger, watched, trained, and all still there."""

import json
import shutil
import time
from contextlib import suppress
from urllib.parse import urlencode

import pytest
from selenium import webdriver
from selenium.common.exceptions import NoSuchElementException, StaleElementReferenceException
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.action_builder import ActionBuilder
from selenium.webdriver.common.actions.interaction import POINTER_TOUCH
from selenium.webdriver.common.actions.pointer_input import PointerInput
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from tests.studio.server import serving

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")
PATIENCE = 900  # seconds that a loaded machine may take to train, or to be quick

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome"),
    pytest.mark.skipif(DRIVER is None, reason="needs chromedriver"),
]


class Tab:
    """A tab of a browser, and what a user does in it."""

    def __init__(self, driver, width):
        self.driver, self.is_touched = driver, width < 600

    def find(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def text(self, selector):
        return self.find(selector).text

    def button(self, label):
        path = f"//button[@aria-label='{label}' or .//*[normalize-space(text())='{label}']]"
        (button, *_) = self.until(
            lambda: [one for one in self.driver.find_elements(By.XPATH, path) if one.is_displayed()]
        )
        return button

    def press(self, label):
        button = self.button(label)
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
        button.click()
        time.sleep(0.3)

    def write(self, selector, text):
        field = self.find(selector)
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", field)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(text, Keys.TAB)
        time.sleep(0.3)

    def stroke(self, shape, *cells):
        """Draws over cells, with a mouse or a finger."""
        canvas = self.find(".studio-grid canvas")
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
        time.sleep(0.3)
        box = self.driver.execute_script("return arguments[0].getBoundingClientRect().toJSON()", canvas)
        high, wide = box["height"] / shape[0], box["width"] / shape[1]
        points = [(int(box["x"] + (col + 0.5) * wide), int(box["y"] + (row + 0.5) * high)) for row, col in cells]
        pointer = PointerInput(POINTER_TOUCH, "finger") if self.is_touched else PointerInput("mouse", "mouse")
        actions = ActionBuilder(self.driver, mouse=pointer, duration=40)
        actions.pointer_action.move_to_location(*points[0]).pointer_down()
        for point in points[1:]:
            actions.pointer_action.move_to_location(*point)
        actions.pointer_action.pointer_up()
        actions.perform()
        time.sleep(0.5)

    def until(self, condition, seconds=300):
        """Waits until something is so, and returns it; elements may come and go meanwhile."""
        end, found = time.monotonic() + seconds, None
        while not found:
            with suppress(StaleElementReferenceException, NoSuchElementException):
                found = condition()
            assert found or time.monotonic() < end, self.words()
            time.sleep(0 if found else 0.25)
        return found

    def words(self):
        return self.driver.execute_script("return document.body.innerText")

    def says(self, words, seconds=300):
        self.until(lambda: words in self.words(), seconds)

    def scene(self, name):
        return self.driver.execute_script("return document.querySelector('.studio-scene').dataset[arguments[0]]", name)

    def check(self):
        """Nothing was complained about, and the page fits its window."""
        assert self.driver.get_log("browser") == []
        wide, window = self.driver.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert wide <= window

    def shot(self, path):
        assert self.driver.save_screenshot(str(path))


@pytest.fixture(scope="module")
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in OPTIONS:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def server(tmp_path_factory, browser):
    """A studio that was just visited for the first time."""
    with serving(tmp_path_factory.mktemp("studio") / "robots") as studio:
        browser.get(studio.address)
        Tab(browser, 1280).says("A body: 22 voxels")
        yield studio


@pytest.fixture
def tab(server, browser, width):
    """The newest design, in a window of this width."""
    metrics = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get(server.address)
    tab = Tab(browser, width)
    tab.says("A body:")
    return tab


@pytest.mark.parametrize(("width", "env_steps"), [(1280, 20_000), (400, 2_000)])
def test_a_biped_is_drawn_painted_watched_and_trained(server, tab, tmp_path, width, env_steps):
    shape = (5, 5)
    tab.press("New design")
    tab.press("Empty grid")
    tab.says("Nothing is drawn yet.")
    tab.stroke(shape, (0, 0), (0, 4))  # the canvas fills what lies between
    tab.press("brush vertical")
    tab.stroke(shape, (1, 0), (4, 0))
    tab.stroke(shape, (1, 4), (4, 4))
    tab.says("A body: 13 voxels, 13 actuators.")
    tab.press("brush erase")
    tab.stroke(shape, (0, 2))
    tab.says("It falls apart: 2 pieces")
    tab.press("Undo (Ctrl+Z)")
    tab.says("A body: 13 voxels, 13 actuators.")
    assert tab.find("textarea").get_attribute("value") == "HHHHH\nV...V\nV...V\nV...V\nV...V"
    tab.press("Stiffness")
    tab.stroke(shape, (0, 0), (0, 4))
    tab.says("stiffness 1 to 2")
    tab.until(lambda: float(tab.scene("step") or 0) > 5, 300)  # kernels may have to be compiled
    tab.until(lambda: float(tab.scene("fps") or 0) >= 30, PATIENCE)
    tab.shot(tmp_path / "watched.png")
    tab.press("Play or pause")
    stands = tab.until(lambda: _standing(tab))
    tab.press("One step")
    tab.until(lambda: float(tab.scene("step")) == float(stands) + 1)
    tab.press("Play or pause")
    tab.press("Start")
    tab.says("Training 1: running", PATIENCE)
    tab.until(lambda: _steps(tab) >= env_steps, PATIENCE)
    tab.press("Stop")
    tab.says("Training 1: stopped", PATIENCE)
    said = _status(tab)
    tab.shot(tmp_path / "trained.png")
    tab.driver.refresh()
    tab.says("A body: 13 voxels, 13 actuators, stiffness 1 to 2.")
    tab.until(lambda: _status(tab) == said)
    tab.until(lambda: float(tab.scene("step") or 0) > 5)
    assert "Training 1" in tab.driver.execute_script(
        "return [...document.querySelectorAll('.q-select')].map((one) => one.innerText).join()"
    )
    assert tab.find(".studio-chart canvas").is_displayed()
    if width == 400:
        tab.button("Resume")
    else:
        tab.press("Resume")
        tab.says("Training 1: running", PATIENCE)
        tab.press("Stop")
        tab.says("Training 1: stopped", PATIENCE)
    tab.check()
    saved = server.ask(tab.driver.current_url.split(str(server.port))[1])
    assert saved[0] == 200


def _standing(tab):
    """The step where the robot has stood for half a second, or None."""
    step = tab.scene("step")
    time.sleep(0.5)
    return step if tab.scene("step") == step else None


def _status(tab):
    return tab.until(lambda: tab.text("[role=status].studio-small"))


def _steps(tab):
    words = _status(tab).split(" · ")
    return int(words[1].split(" of ")[0].replace(",", "")) if len(words) > 1 else 0


@pytest.mark.parametrize("width", [1280, 400])
def test_every_page_fits_its_window_and_works_by_keyboard(server, tab):
    base = server.address.split("/?")[0]
    designs = []
    evil = "<img src=x onerror=alert(1)>"  # as the name of a design that somebody shares
    for body, n_voxels in (("HHH/V.V", 5), ("HHVV/S..R", 6)):
        shared = json.dumps({"name": evil, "design": {"body": body}})
        tab.driver.get(f"{base}/open?{urlencode({'design': shared})}")
        tab.says(evil)
        tab.press("Keep it and open")
        tab.says(f"A body: {n_voxels} voxels")
        designs.append(tab.driver.current_url.split("/d/")[1])
    canvas = tab.find(".studio-grid canvas")
    canvas.click()
    ActionChains(tab.driver).send_keys(Keys.DELETE, "r", Keys.ARROW_LEFT, " ").perform()
    tab.until(lambda: tab.find("textarea").get_attribute("value").count("R") > 1)
    ActionChains(tab.driver).key_down(Keys.CONTROL).send_keys("z", "z").key_up(Keys.CONTROL).perform()
    for name in ("Terrain", "Stiffness", "Body", "Material", "Evolve", "Train"):
        tab.press(name)
        tab.check()
    tab.driver.get(f"{base}/designs")
    tab.says(evil)
    tab.check()
    for path in (f"/compare/{designs[0]}/{designs[1]}", f"/d/{designs[0]}"):
        tab.driver.get(base + path)
        tab.until(lambda: float(tab.scene("step") or 0) > 5)
        tab.check()
