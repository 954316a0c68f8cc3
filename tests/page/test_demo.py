"""`stictiond demo` opens a page that has answers within a minute and is accessible."""

import re
import time

import pytest
from conftest import LONG, api, skipped
from playwright.sync_api import expect

from daemon import eventually

# Expected results of the demo: each loop's final tile, and the filter under which its verdict is counted.
TRUTH = {
    "FIC101": ("maintenance required", "sticks"),
    "TIC102": ("nothing found", "steady"),
    # A cause is a hint, shown only once most of the last windows name it.
    "PIC103": ("out of specification", "tuning|oscillates"),
    "FIC104": ("out of specification", "disturbed|oscillates"),
}
VIEWS = {"overview": "", "loop": "#/loop/FIC101", "alarms": "#/alarms", "plant": "#/groups", "workbench": "#/workbench"}
WIDTHS = (390, 820, 1400)


def tile(page, name, status):
    return page.get_by_role("link", name=re.compile(rf"^{name}, {status}"))


def test_the_four_loops_have_the_right_verdicts(demo, open_page):
    page = open_page(demo)
    for name, (status, _) in TRUTH.items():
        expect(tile(page, name, status)).to_be_visible(timeout=60_000)
    page.get_by_label("Find").fill("10")
    verdicts = page.get_by_role("group", name="Filter by verdict")
    for name, (status, chip) in TRUTH.items():
        shown = []
        for pressed in verdicts.get_by_role("button", name=re.compile(f"^({chip})")).all():
            if pressed.is_enabled():
                pressed.click()
                shown.append(tile(page, name, "").is_visible())
                pressed.click()
        assert shown.count(True) == 1, (name, shown)
    expect(page.get_by_role("heading", level=1)).to_contain_text("1 of 4 valves needs maintenance: FIC101")
    row = next(r for r in api(demo, "/loops")["loops"] if r["name"] == "FIC101")
    assert row["s_interval"][0] < 7.0 < row["s_interval"][1], row


def look(page, where):
    """The findings of axe, one a line."""
    found = page.evaluate("() => axe.run(document, { resultTypes: ['violations'] })")["violations"]
    return [f"{where}: {v['id']} ({v['impact']}): {v['help']}: {n['html'][:160]}" for v in found for n in v["nodes"][:2]]


def settled(page):
    """Waits until everything is loaded, scrolling to parts that load only near the screen."""
    waiting = """() => {
      const bone = document.querySelector('main [aria-busy=true], main .skeleton');
      bone?.scrollIntoView();
      return bone !== null || document.fonts.status !== 'loaded';
    }"""
    eventually("the page to be loaded", lambda: not page.evaluate(waiting))


WIDER = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"


@pytest.mark.parametrize("view", VIEWS)
def test_axe_finds_nothing(demo, open_page, axe_source, view):
    if not axe_source:
        skipped("axe-core cannot be had (npm): accessibility was not looked at")
        pytest.skip("no axe-core")
    eventually("the alarm", lambda: any(row["active"] for row in api(demo, "/loops")["loops"]), within=120)
    page = open_page(demo, VIEWS[view])
    expect(page.get_by_role("heading", level=1).first).to_be_visible()
    settled(page)
    found = []
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        schemes = ("light", "dark") if LONG else ("dark",) if width == 820 else ("light",)
        for scheme in schemes:
            page.emulate_media(color_scheme=scheme)
            # Charts follow a new width a frame later, on a busy machine some frames.
            until = time.monotonic() + 5
            while (wide := page.evaluate(WIDER)) > 0 and time.monotonic() < until:
                page.wait_for_timeout(50)
            found += [f"{view} at {width}: {wide} px wider than the screen"] if wide > 0 else []
            found += look(page, f"{view} at {width} {scheme}")
    assert not found, "\n".join(found)


def test_the_daemons_page_says_where_files_are_opened(demo, open_page):
    page = open_page(demo)
    page.get_by_role("navigation", name="Main").get_by_role("link", name="Workbench").click()
    expect(page.get_by_role("heading", name="Workbench", level=1)).to_be_visible()
    expect(page.get_by_role("main")).to_contain_text("stictiond workbench FILE")
    assert page.locator("input[type=file]").count() == 0 and api(demo, "/site")["workbench"] is False
