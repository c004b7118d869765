"""The report in a real Chromium, from disk: sorting, silence, no requests, every figure there and legible.

Skipped, with the reason, only on a machine that has no Chromium with its driver."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from railstate.benchmarks.telling.figures.catalogue import drawn
from railstate.benchmarks.telling.figures.data import load_results
from railstate.benchmarks.telling.report import write_report

from ..synthetic_results import write_results

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")

pytestmark = pytest.mark.skipif(not (BROWSER and DRIVER), reason="no Chromium with chromedriver on this machine "
                                                                 "(Debian: apt install chromium chromium-driver)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = write_results(tmp_path_factory.mktemp("browser") / "run")
    write_report(made)
    return made


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(BROWSER)
    profile = tmp_path_factory.mktemp("profile")
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
                 "--disable-background-networking", "--disable-component-update", "--disable-sync",
                 "--disable-default-apps", f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    yield driver
    driver.quit()


def visit(browser: Any, folder: Path, width: int, scheme: str = "light") -> None:
    """Open the report with all its parts unfolded, at a width in CSS pixels."""
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600})
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia",
                            {"media": "", "features": [{"name": "prefers-color-scheme", "value": scheme}]})
    browser.get((folder / "report.html").as_uri())
    browser.execute_script("document.querySelectorAll('details').forEach(part => { part.open = true; })")


def test_no_console_message_and_no_request_leaves_the_page(browser: Any, folder: Path) -> None:
    browser.get_log("browser")
    browser.get_log("performance")
    visit(browser, folder, 1600)
    browser.execute_script("document.querySelector('table.sortable button').click()")
    assert browser.get_log("browser") == []
    events = [json.loads(line["message"])["message"] for line in browser.get_log("performance")]
    urls = [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]
    assert [url for url in urls if not url.startswith("data:")] == [(folder / "report.html").as_uri()]


COLUMN = """
const table = document.querySelector('#ningbo-metro .variant table.sortable');
const head = table.tHead.rows[0].cells[arguments[0]];
if (arguments[1]) head.querySelector('button').click();
return [head.getAttribute('aria-sort'), [...table.tBodies[0].rows].map(
    row => [row.cells[0].innerText.trim(), row.cells[arguments[0]].dataset.sort ?? null])];
"""


def test_tables_sort_both_ways_and_put_empty_cells_last(browser: Any, folder: Path) -> None:
    visit(browser, folder, 1600)
    _, before = browser.execute_script(COLUMN, 1, False)
    order, rows = browser.execute_script(COLUMN, 1, True)
    values = [float(value) for _, value in rows]
    assert order == "ascending"
    assert values == sorted(values) != [float(value) for _, value in before]
    order, rows = browser.execute_script(COLUMN, 1, True)
    assert order == "descending"
    assert [float(value) for _, value in rows] == values[::-1]
    for _ in range(2):
        _, rows = browser.execute_script(COLUMN, 3, True)
        empty = [value is None for _, value in rows]
        assert empty == sorted(empty)
        assert any(empty)
    _, rows = browser.execute_script(COLUMN, 0, True)
    assert [label for label, _ in rows] == sorted(label for label, _ in rows)
    assert browser.execute_script(COLUMN, 1, False)[0] is None


def test_tables_sort_by_keyboard(browser: Any, folder: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    visit(browser, folder, 1600)
    head = "#ningbo-metro .variant table.sortable th:nth-child(2) button"
    browser.find_element("css selector", head).send_keys(Keys.ENTER)
    assert browser.execute_script(COLUMN, 1, False)[0] == "ascending"


FIGURES = """
const found = [];
for (const figure of document.querySelectorAll('figure')) {
  const svg = figure.querySelector('svg'), frame = svg.getBoundingClientRect(), bad = [];
  const texts = [...svg.querySelectorAll('text')].map(text => [text, text.getBoundingClientRect()]);
  for (const [text, box] of texts) {
    if (box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1
        || box.bottom > frame.bottom + 1)
      bad.push('cut: ' + text.textContent);
  }
  for (const [i, [a, p]] of texts.entries()) for (const [b, q] of texts.slice(i + 1)) {
    const across = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const down = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (across > 1 && down > 0.35 * Math.min(p.height, q.height)) bad.push(a.textContent + ' over ' + b.textContent);
  }
  const drawn = [...svg.querySelectorAll('path')].filter(path => {
    const colour = (path.getAttribute('stroke') ?? '') + (path.getAttribute('fill') ?? ''), box = path.getBBox();
    return /--c\\d|--ink/.test(colour) && (box.width > 0 || box.height > 0);
  });
  const scale = frame.width / svg.viewBox.baseVal.width;
  const sizes = texts.map(([text]) => scale * parseFloat(text.getAttribute('font-size')));
  found.push({name: figure.dataset.figure, drawn: drawn.length, bad, least: Math.min(...sizes),
              right: frame.right, caption: figure.querySelector('figcaption').textContent.length});
}
return found;
"""


@pytest.mark.parametrize("width", [400, 1600])
def test_every_figure_is_there_filled_and_legible(browser: Any, folder: Path, width: int) -> None:
    visit(browser, folder, width)
    found = browser.execute_script(FIGURES)
    expected = sorted(figure.name for figure, *_ in drawn(load_results(folder)))
    assert sorted(figure["name"] for figure in found) == expected
    for figure in found:
        assert figure["drawn"] >= 1, figure
        assert figure["bad"] == [], figure
        assert figure["least"] >= 9.5, figure
        assert figure["right"] <= width, figure
        assert figure["caption"] > 20, figure


@pytest.mark.parametrize("width", [400, 1600])
def test_the_page_never_scrolls_sideways_and_its_text_is_legible(browser: Any, folder: Path, width: int) -> None:
    visit(browser, folder, width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    least = browser.execute_script("""
        return Math.min(...[...document.querySelectorAll('p, li, td, th, small, dd, dt, figcaption, code')]
          .filter(part => part.innerText?.trim()).map(part => parseFloat(getComputedStyle(part).fontSize)));""")
    assert least >= 12


CONTRAST = """
const light = text => {
  const [r, g, b] = text.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
    .map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
  return .2126 * r + .7152 * g + .0722 * b;
};
const paper = light(getComputedStyle(document.body).backgroundColor);
const ratio = colour => {
  const own = light(colour);
  return (Math.max(own, paper) + .05) / (Math.min(own, paper) + .05);
};
const parts = document.querySelectorAll('p, li, td, td small, th, a, summary, figcaption, code, svg text');
return [paper, Math.min(...[...parts].map(
  part => ratio(part.closest('svg') ? getComputedStyle(part).fill : getComputedStyle(part).color)))];
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_contrast_in_both_themes(browser: Any, folder: Path, scheme: str) -> None:
    visit(browser, folder, 1600, scheme)
    paper, least = browser.execute_script(CONTRAST)
    assert (paper > 0.5) == (scheme == "light")
    assert least >= 4.5


def test_print_is_light_and_unfolded_whatever_the_screen(browser: Any, folder: Path) -> None:
    visit(browser, folder, 1600, "dark")
    browser.execute_script("document.querySelectorAll('details').forEach(part => { part.open = false; })")
    browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    assert browser.execute_script("return document.querySelectorAll('details:not([open])').length") == 0
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {
        "media": "print", "features": [{"name": "prefers-color-scheme", "value": "dark"}]})
    assert browser.execute_script(CONTRAST)[0] > 0.9
    paper = 1030
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                            {"width": paper, "height": 730, "deviceScaleFactor": 1, "mobile": False})
    assert browser.execute_script("""return Math.max(...[...document.querySelectorAll('table, svg, p')]
        .map(part => part.getBoundingClientRect().right));""") <= paper


def test_a_link_to_a_folded_variant_unfolds_it(browser: Any, folder: Path) -> None:
    visit(browser, folder, 1600)
    browser.get((folder / "report.html").as_uri() + "#ningbo-metro--white")
    assert browser.execute_script("return document.getElementById('ningbo-metro--white').open")
