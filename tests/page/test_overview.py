"""The overview shows the daemon's sentences, signs and figures."""

from conftest import api
from daemon import eventually
from playwright.sync_api import expect


def test_headline_and_tiles_say_what_the_daemon_says(plant, open_page):
    page = open_page(plant)
    heading = page.get_by_role("heading", level=1)
    eventually("the daemon's headline", lambda: api(plant, "/loops")["headline"]["words"] == heading.inner_text())
    row = next(row for row in api(plant, "/loops")["loops"] if row["name"] == "FIC101")
    tile = page.locator("a.tile", has_text="FIC101")
    for part in (row["probability"], row["size"], row["grade"]):
        if part:
            expect(tile).to_contain_text(part)
