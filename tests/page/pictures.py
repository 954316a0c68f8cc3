"""Regenerates docs/pictures with the program in target/debug; first `bash tests/page/run.sh --fetch`, then

    CHROMIUM=chromium target/python/bin/python -m pytest -c tests/page/pytest.ini tests/page/pictures.py

The overview and a loop are from `stictiond demo`; the workbench has a recording with the force model of the valve. No test
compares them, since another version of the browser draws other pixels.
"""

import pytest
from conftest import Demo, api
from playwright.sync_api import expect
from test_demo import settled
from test_workbench import Bench, run

from daemon import ROOT, eventually

PICTURES = ROOT / "docs" / "pictures"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    running = Demo(tmp_path_factory.mktemp("demo"))
    yield running
    running.process.terminate()
    running.process.wait(timeout=15)


def keep(page, name):
    page.screenshot(path=PICTURES / f"{name}.png")


def test_overview_and_loop(plant, open_page):
    eventually("the alarm", lambda: any(row["active"] for row in api(plant, "/loops")["loops"]), within=120)
    # The displayed cause is the one that most of the last windows name, so wait for several.
    eventually("windows of all loops", lambda: all(len(row["recent"]) >= 6 for row in api(plant, "/loops")["loops"]), within=120)
    page = open_page(plant, viewport={"width": 1200, "height": 560})
    settled(page)
    keep(page, "overview")
    page = open_page(plant, "#/loop/FIC101", viewport={"width": 1200, "height": 1500})
    expect(page.get_by_role("heading", level=1).first).to_be_visible()
    # The demo's loops continue, so this view is never settled for long; its parts load within seconds.
    page.wait_for_timeout(10_000)
    keep(page, "loop")


def test_workbench(tmp_path, open_page):
    bench = Bench(tmp_path, ROOT / "recordings" / "physical.mcap")
    try:
        page = open_page(bench, viewport={"width": 1200, "height": 1300})
        run(page, "Run estimate", 1)
        expect(page.get_by_role("region", name="Runs compared").get_by_text("sticks").first).to_be_visible(timeout=120_000)
        settled(page)
        page.evaluate("scrollTo(0, 0)")
        keep(page, "workbench")
    finally:
        bench.process.terminate()
        bench.process.wait(timeout=15)
