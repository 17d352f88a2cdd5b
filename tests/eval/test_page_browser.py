"""The report in headless Chromium: no errors, no network, a player that plays, tables that sort, names as text."""

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from report_material import HOSTILE, sweep
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from moteslam.eval.page.document import gather, page
from moteslam.eval.results import write_results

pytestmark = pytest.mark.slow
ARGUMENTS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--window-size=1280,900", "--lang=en"),
)
Browser = webdriver.Chrome


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Chromium, with its log and all that it asks for. Where it is not installed tests are skipped, but in CI."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        missing = "no chromium with chromedriver (Debian: apt install chromium chromium-driver)"
        pytest.fail(missing) if os.environ.get("CI") else pytest.skip(missing)
    options = Options()
    options.binary_location = chromium
    for argument in (*ARGUMENTS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(driver))
    yield found
    found.quit()


@pytest.fixture(scope="module")
def pages(run, simulation, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of a sweep, of result folders, and of names that nobody means well with."""
    folder = tmp_path_factory.mktemp("pages")
    for name in ("first", "second"):
        write_results(folder / name, run[0], simulation.truth, figures=False)
    (folder / "second" / "config.toml").write_text("particles = 7\n")
    made = {
        "sweep": (gather([sweep(folder / "s.sweep", fail=3)]), "a sweep"),
        "runs": (gather([folder / "first", folder / "second"]), "two runs"),
        "hostile": (gather([sweep(folder / "h.sweep", fail=3), folder / "first"]), HOSTILE),
    }
    hostile = made["hostile"][0]
    for number, run_ in enumerate(list(hostile.runs)):
        if number % 2:
            varied = ((HOSTILE, number % 3), ("key", f"{HOSTILE}{number % 3}"))
            about = {"scenario": HOSTILE, "platform": HOSTILE, "configuration": f"{HOSTILE} {number % 3}"}
            planned = run_.run.model_copy(update={**about, "seed": number, "varied": varied})
            hostile.runs[number] = replace(run_, run=planned, error=HOSTILE, issues=({"message": HOSTILE},))
    hostile.documents.append((HOSTILE, HOSTILE))
    for name, (material, title) in made.items():
        (folder / f"{name}.html").write_text(page(material, title=title), encoding="utf-8")
    return {name: folder / f"{name}.html" for name in made}


def opened(browser: Browser, file: Path) -> None:
    browser.get_log("browser")
    browser.get_log("performance")
    browser.get(file.as_uri())
    WebDriverWait(browser, 60).until(lambda at: at.execute_script("return document.documentElement.dataset.ready"))


def complaints(browser: Browser) -> list[str]:
    """What the page logged, and what it asked for beyond itself."""
    found = [entry["message"] for entry in browser.get_log("browser")]
    for entry in browser.get_log("performance"):
        event = json.loads(entry["message"])["message"]
        url = event["params"]["request"]["url"] if event["method"] == "Network.requestWillBeSent" else "data:"
        found += [] if url.startswith(("data:", "blob:")) or url == browser.current_url else [url]
    return found


def robot(browser: Browser) -> bytes:
    """The canvas as a picture, once it is drawn."""
    script = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done(0)))"
    browser.execute_async_script(script)
    return browser.find_element(By.ID, "map").screenshot_as_png


@pytest.mark.parametrize("name", ["sweep", "runs", "hostile"])
def test_no_error_and_no_request(name: str, browser: Browser, pages: dict[str, Path]) -> None:
    opened(browser, pages[name])
    for scheme in ("dark", "light", ""):
        Select(browser.find_element(By.ID, "scheme")).select_by_value(scheme)
    assert complaints(browser) == []


def test_slider_and_keyboard_move_the_robot(browser: Browser, pages: dict[str, Path]) -> None:
    opened(browser, pages["runs"])
    WebDriverWait(browser, 20).until(lambda _: "s of" in browser.find_element(By.ID, "now").text)
    unit = WebDriverWait(browser, 20).until(lambda _: browser.find_element(By.CSS_SELECTOR, "#error .ytitle").text)
    assert f" {unit.partition('[')[2][:-1]} " in browser.find_element(By.ID, "now").text  # one unit in both
    slider, button, canvas = (browser.find_element(By.ID, name) for name in ("time", "play", "map"))
    last = robot(browser)
    slider.send_keys(Keys.HOME)
    first = robot(browser)
    assert browser.find_element(By.ID, "now").text.startswith("0.0 s of")
    slider.send_keys(Keys.ARROW_RIGHT * 30)
    assert len({first, robot(browser), last}) == 3
    assert int(slider.get_attribute("value") or 0) == 30
    Select(browser.find_element(By.ID, "speed")).select_by_value("1")
    slider.send_keys(Keys.HOME + " ")
    WebDriverWait(browser, 20).until(lambda _: int(slider.get_attribute("value") or 0) > 5)
    assert button.text == "Pause"
    slider.send_keys(" ")
    assert button.text == "Play"
    before = robot(browser)
    canvas.send_keys("+")
    nearer = robot(browser)
    canvas.send_keys(Keys.ARROW_LEFT)
    assert len({before, nearer, robot(browser)}) == 3


def test_names_are_text_everywhere(browser: Browser, pages: dict[str, Path]) -> None:
    opened(browser, pages["hostile"])
    assert browser.title.startswith("</script><script>")
    assert "\\u202e" in browser.title
    counts = "document.querySelectorAll('img, iframe, object').length, document.scripts.length"
    images, scripts, text = browser.execute_script(f"return [{counts}, document.body.innerText]")
    assert images == 0
    assert text.count("<img src=x onerror=alert(1)>") > 30
    assert not {"\u202e", "\x1b"} & set(text)
    assert scripts == 6  # two of the page, three of data, and the charts' unpacked
    drawn = browser.execute_script(
        "return [...document.querySelectorAll('.chart text')].map((t) => t.textContent).join(' ')"
    )
    assert "</script><script>" in drawn
    assert "\u202e" not in drawn
    assert not browser.find_elements(By.CSS_SELECTOR, ".chart a")
