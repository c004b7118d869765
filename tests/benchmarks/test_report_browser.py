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
from railstate.benchmarks.telling.report.sections import FOR_EACH

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
    browser.execute_script("document.querySelector('table.sortable thead button').click()")
    assert browser.get_log("browser") == []
    events = [json.loads(line["message"])["message"] for line in browser.get_log("performance")]
    urls = [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]
    assert [url for url in urls if not url.startswith("data:")] == [(folder / "report.html").as_uri()]


COLUMN = """
const table = document.querySelector(arguments[0]), head = table.tHead.rows[0].cells[arguments[1]];
if (arguments[2]) head.querySelector('button').click();
return [head.getAttribute('aria-sort'), [...table.tBodies[table.tBodies.length - 1].rows].map(
    row => [row.cells[0].innerText.trim(), row.cells[arguments[1]].dataset.v ?? null])];
"""
VARIANT = "#cbtc-csma-table3 table.sortable"


def test_tables_sort_both_ways_and_put_empty_cells_last(browser: Any, folder: Path) -> None:
    visit(browser, folder, 1400)
    _, before = browser.execute_script(COLUMN, VARIANT, 2, False)
    order, rows = browser.execute_script(COLUMN, VARIANT, 2, True)
    values = [float(value.split("|")[0]) for _, value in rows if value]
    assert order == "ascending" and values == sorted(values) and rows[-1][1] is None and len(rows) == len(before)
    order, rows = browser.execute_script(COLUMN, VARIANT, 2, True)
    assert order == "descending" and rows[-1][1] is None
    assert [float(value.split("|")[0]) for _, value in rows if value] == values[::-1]
    _, rows = browser.execute_script(COLUMN, VARIANT, 0, True)
    assert [label for label, _ in rows] == sorted(label for label, _ in rows)


def test_the_overview_is_sorted_and_walked_by_keyboard(browser: Any, folder: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    visit(browser, folder, 1400)
    browser.find_element("css selector", "#matrix thead th:nth-child(2) button").send_keys(Keys.ENTER)
    order, rows = browser.execute_script(COLUMN, "#matrix", 1, False)
    least = browser.execute_script("return [...document.querySelectorAll('#matrix td.least .q0')]"
                                   ".map(part => parseFloat(part.childNodes[1].textContent))")
    assert order == "ascending" and least == sorted(least)
    assert browser.execute_script("return document.getElementById('sorted').textContent") == "sorted by least error"
    browser.execute_script("document.querySelector('#matrix tbody + tbody a').focus()")
    keys = ActionChains(browser)
    keys.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_DOWN, Keys.ENTER).perform()
    target = rows[1][0].replace("/", "-")
    assert browser.execute_script("return location.hash") == f"#{target}"
    browser.find_element("id", "a1").send_keys(Keys.SPACE)
    shown = browser.execute_script("""return [...document.querySelectorAll('#matrix .v')].filter(
        part => part.offsetParent && part.closest('tbody:last-child')).map(part => part.className)""")
    assert shown and all("v2" in name for name in shown)  # the second reference, the first quantity


SAVED = """
let text = null;
const make = URL.createObjectURL;
URL.createObjectURL = (blob) => { text = blob; return make(blob); };
document.querySelectorAll(arguments[0])[0].click();
URL.createObjectURL = make;
const done = arguments[arguments.length - 1];
text.text().then(done);
"""


def test_what_is_shown_can_be_saved(browser: Any, folder: Path) -> None:
    visit(browser, folder, 1400)
    metro = browser.execute_async_script(SAVED, "#ningbo-metro-switching button[data-save=table]").splitlines()
    assert metro[0].startswith("entry,position verdict,position value,position low,position high,position ratio,")
    cell = next(c for c in load_results(folder).scenarios["ningbo-metro"] if c.variant == "switching")
    for text, line in zip(metro[1:], cell.rankings[0].lines, strict=True):
        label, verdict, value, *_ = text.split(",")
        assert (label, verdict) == (line["estimator"], line["verdict"])
        assert float(value) == pytest.approx(line["value"], rel=1e-5)
    curves = browser.execute_async_script(SAVED, "#ningbo-metro-switching button[data-save=curves]").splitlines()
    assert curves[0] == "entry,time_s,rms_error" and len(curves) == 1 + 60 * 6
    first = curves[1].split(",")
    assert first[0] == "ekf" and float(first[2]) == pytest.approx(cell.rankings[0].lines[0]["value"], rel=0.3)
    overview = browser.execute_async_script(SAVED, "main > button[data-save=table]").splitlines()
    assert overview[0] == "setting,least error,entry,Other" and len(overview) == 7
    assert browser.execute_async_script(SAVED, "button[data-save=svg]").startswith("<svg")


def test_without_script_the_page_is_complete(browser: Any, folder: Path) -> None:
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        visit(browser, folder, 1400)
        assert len(browser.find_elements("css selector", "#matrix a.v0")) == 6
        assert all(part.is_displayed() for part in browser.find_elements("css selector", "#matrix a.v0"))
        assert not any(part.is_displayed() for part in browser.find_elements("css selector", ".save, #sort"))
        browser.find_element("id", "a1").click()  # other views need none either
        assert not browser.find_element("css selector", "#matrix a.v0").is_displayed()
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


FIGURES = """
const found = [];
for (const figure of document.querySelectorAll('figure[data-figure]')) {
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
    const said = name => path.closest(`[${name}]`)?.getAttribute(name) ?? '', box = path.getBBox();
    const colour = said('stroke') + said('fill');
    return /--c\\d|--ink/.test(colour) && (box.width > 0 || box.height > 0);
  });
  const scale = frame.width / svg.viewBox.baseVal.width;
  const sizes = texts.map(([text]) => scale * parseFloat(text.closest('[font-size]').getAttribute('font-size')));
  found.push({name: figure.dataset.figure, drawn: drawn.length, bad, least: Math.min(...sizes),
              right: frame.right, caption: figure.querySelector('figcaption').textContent.length});
}
return found;
"""


@pytest.mark.parametrize("width", [400, 1600])
def test_every_figure_is_there_filled_and_legible(browser: Any, folder: Path, width: int) -> None:
    visit(browser, folder, width)
    found = browser.execute_script(FIGURES)
    default = {"ningbo-metro": "switching", "cbtc-csma": "uniform", "braking-rate": "paper"}
    expected = sorted(figure.name for figure, scenario, variant, _ in drawn(load_results(folder))
                      if figure.name not in FOR_EACH and variant in ("", default[scenario]))
    assert sorted(figure["name"] for figure in found) == expected
    for figure in found:
        assert figure["drawn"] >= 1, figure
        assert figure["bad"] == [], figure
        assert figure["least"] >= 9.5, figure
        assert figure["right"] <= width, figure
        assert figure["caption"] > 20, figure


@pytest.mark.parametrize("width", [390, 800, 1400])
def test_the_page_never_scrolls_sideways_and_its_text_is_legible(browser: Any, folder: Path, width: int) -> None:
    visit(browser, folder, width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    least = browser.execute_script("""
        return Math.min(...[...document.querySelectorAll('p, li, td, th, small, dd, dt, figcaption, code')]
          .filter(part => part.innerText?.trim()).map(part => parseFloat(getComputedStyle(part).fontSize)));""")
    assert least >= 10.5
    small = browser.execute_script("""return [...document.querySelectorAll('button, summary, select, #matrix a.v')]
        .filter(part => part.offsetParent && part.getBoundingClientRect().height < 24).map(part => part.outerHTML)""")
    assert small == []  # what is pressed


CONTRAST = """
const light = text => {
  const [r, g, b] = text.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
    .map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
  return .2126 * r + .7152 * g + .0722 * b;
};
const ground = part => {  // the colour behind a part
  for (let at = part; at; at = at.parentElement) {
    const colour = getComputedStyle(at).backgroundColor;
    if (!/^rgba\\(.*, 0\\)$|transparent/.test(colour)) return light(colour);
  }
  return light('rgb(255, 255, 255)');
};
const paper = ground(document.body), found = [];
const parts = 'p, li, td, small, th, a, summary, figcaption, caption, code, button, .c, b, dd, dt, label, svg text';
for (const part of document.querySelectorAll(parts)) {
  if (!part.textContent.trim() || !part.getClientRects().length) continue;
  const own = light(part.closest('svg') ? getComputedStyle(part).fill : getComputedStyle(part).color);
  const behind = part.closest('svg') ? paper : ground(part);
  found.push([(Math.max(own, behind) + .05) / (Math.min(own, behind) + .05), part.outerHTML.slice(0, 120)]);
}
found.sort((a, b) => a[0] - b[0]);
return [paper, found[0][0], found[0][1], found.length];
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_contrast_in_both_themes(browser: Any, folder: Path, scheme: str) -> None:
    visit(browser, folder, 1600, scheme)
    paper, least, which, count = browser.execute_script(CONTRAST)
    assert (paper > 0.5) == (scheme == "light") and count > 300
    assert least >= 4.5, which


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
        .filter(part => part.getClientRects().length).map(part => part.getBoundingClientRect().right));""") <= paper
