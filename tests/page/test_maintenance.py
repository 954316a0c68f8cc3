"""The maintenance view: the list, its grouping, before and after a review, the table for spreadsheets, and paper."""

import csv
import io
import json
import urllib.request

import pytest
from conftest import api
from playwright.sync_api import expect

NAME = "<b>TIC102</b>"


def work(rank, name, area):
    return {
        "rank": rank, "loop": name, "area": area, "equipment": f"V-{rank}", "criticality": 3, "alarm": True, "p_stiction": 0.9,
        "grade": "A", "s": 4.0, "op_unit": "%", "s_trend": None, "removed": None, "pending": False, "window_end_ms": 1.7e12,
        "probability": "p 0.90", "size": "4 (3.8 to 4.2) % of travel", "benefit": "40 to 60 % less PV variation",
        "next_step": "bump test, then inspect", "cost": 0.5, "what_to_do": "Do a bump test.", "why": "Criticality 3 of 5; a repair removes half.", "sure": "Very likely.",
    }


REVIEWED = {
    "loop": "FIC9", "area": None, "equipment": None, "at_ms": 1.7e12, "by": "ann", "label": "stiction", "method": "inspection",
    "note": None, "complete": True,
    "outcome": {
        "before": {"windows": 4, "sticking": 4, "p": 0.9, "s": 4.0, "pv_sd": 2.0},
        "after": {"windows": 4, "sticking": 0, "p": 0.1, "s": None, "pv_sd": 0.5},
        "helped": "yes", "words": "Stiction was seen before the review and is not seen since.",
    },
}


def show(open_page, daemon, items, reviewed, **options):
    page = open_page(daemon, **options)
    answer = json.dumps({"work": items, "reviewed": reviewed, "pending": 0})
    page.route("**/api/v1/maintenance", lambda route: route.fulfill(body=answer, content_type="application/json"))
    page.goto(f"http://{daemon.web}/#/maintenance")
    return page


def test_the_list_groups_by_area_and_shows_what_work_brought(plant, open_page, axe_source):
    page = show(open_page, plant, [work(1, NAME, "North"), work(2, "B", "South"), work(3, "C", "North")], [REVIEWED])
    expect(page.locator("nav a[aria-current=page]")).to_have_text("Maintenance")
    entries = page.locator(".work")
    expect(entries.nth(0).locator("a")).to_have_text(NAME)
    for part in ("4 (3.8 to 4.2) % of travel", "p 0.90", "40 to 60 % less PV variation", "bump test, then inspect"):
        expect(entries.nth(1)).to_contain_text(part)
    # The sentences appear on a click.
    expect(page.get_by_text("Do a bump test.").nth(1)).to_be_hidden()
    page.get_by_role("button", name="Details of B").click()
    expect(page.get_by_text("Do a bump test.").nth(1)).to_be_visible()
    expect(page.locator("tr[data-loop=FIC9]")).to_contain_text("not seen since")
    expect(page.locator("tr[data-loop=FIC9]")).to_contain_text("0.90 → 0.10")
    page.get_by_role("button", name="By area").click()
    expect(page.locator(".work-group h2")).to_have_text(["North", "South"])
    expect(entries.nth(1).locator("a")).to_have_text("C")
    if axe_source:
        assert page.evaluate("axe.run().then(r => r.violations.map(v => v.id))") == []
    page.emulate_media(media="print")
    expect(page.get_by_role("navigation", name="Main")).to_be_hidden()
    expect(page.get_by_role("button", name="Print")).to_be_hidden()
    expect(entries.nth(0)).to_be_visible()


@pytest.mark.parametrize("width", [390, 1000])
def test_nothing_is_wider_than_the_screen(plant, open_page, width):
    page = show(open_page, plant, [work(1, "N" * 60, "North")], [REVIEWED], viewport={"width": width, "height": 800})
    expect(page.locator(".work")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("document.querySelector('.bar').scrollWidth") <= width


def test_the_daemon_lists_its_sticking_loop_for_people_and_spreadsheets(plant):
    listed = {item["loop"]: item for item in api(plant, "/maintenance")["work"]}
    found = listed["FIC101"]
    assert found["what_to_do"] and found["why"] and found["sure"], found
    assert [item["rank"] for item in listed.values()] == list(range(1, len(listed) + 1))
    asked = urllib.request.Request(f"http://{plant.web}/api/v1/maintenance", headers={"Accept": "text/csv"})
    for request in (asked, f"http://{plant.web}/api/v1/maintenance?format=csv"):
        with urllib.request.urlopen(request, timeout=60) as answer:
            assert answer.headers["content-type"].startswith("text/csv")
            rows = list(csv.DictReader(io.StringIO(answer.read().decode())))
        assert "FIC101" in {row["loop"] for row in rows}
