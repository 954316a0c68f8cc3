"""Without a mouse: from the overview to a loop, its alarm acknowledged, and back."""

import re

from conftest import api, loop_path
from playwright.sync_api import expect

LOOP = "FIC101"
MOST_STOPS = 60

# Whether the focus is visible.
SEEN = """() => {
  const node = document.activeElement;
  const style = getComputedStyle(node);
  return (style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) > 0) || style.boxShadow !== 'none';
}"""
NAME = "() => document.activeElement.getAttribute('aria-label') ?? document.activeElement.textContent.trim()"


def tab_to(page, name, key="Tab"):
    """Presses Tab until the element of that name has the focus; every stop must be visible."""
    for _ in range(MOST_STOPS):
        page.keyboard.press(key)
        at = page.evaluate(NAME)
        assert page.evaluate(SEEN), f"no focus to be seen at {at[:60]!r}"
        if re.search(name, at):
            return
    raise AssertionError(f"{MOST_STOPS} stops, and none is {name}")


def test_a_loop_is_reached_its_alarm_acknowledged_and_the_way_back_found(plant, open_page):
    page = open_page(plant)
    expect(page.get_by_role("link", name=re.compile(f"^{LOOP}, maintenance required"))).to_be_visible(timeout=60_000)
    page.keyboard.press("/")
    expect(page.get_by_label("Find")).to_be_focused()
    page.keyboard.type(LOOP)
    expect(page.get_by_text(re.compile("^1 of "))).to_be_visible()
    expect(page.locator("a.tile")).to_have_count(1)
    page.keyboard.press("ArrowDown")
    assert page.evaluate(NAME).startswith(LOOP) and page.evaluate(SEEN)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_contain_text(LOOP)
    tab_to(page, f"^Acknowledge: {LOOP}$")
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_label("Your name")).to_be_focused()
    page.keyboard.type("Bob")
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    assert page.evaluate(NAME) == f"Acknowledge: {LOOP}"
    assert api(plant, loop_path(LOOP))["alarm"]["state"] == "unack"
    page.keyboard.press("Enter")
    expect(dialog.get_by_label("Your name")).to_be_focused()
    page.keyboard.type("Bob")
    page.keyboard.press("Tab")
    page.keyboard.type("seen")
    tab_to(page, "^Acknowledge$")
    page.keyboard.press("Enter")
    expect(dialog).to_have_count(0)
    expect(page.get_by_role("main")).to_contain_text("alarm active, acknowledged")
    assert api(plant, loop_path(LOOP))["alarm"]["acknowledged"]["by"] == "Bob"
    tab_to(page, "^Overview$", key="Shift+Tab")
    page.keyboard.press("Enter")
    expect(page.get_by_label("Find")).to_be_visible()
