"""The data view: the share of loops that can be judged, and the obstacles of the others."""

import json

from playwright.sync_api import expect

NAME = "<b>TIC102</b>"


def obstacle(name, kind, blocks=True, appeared=True):
    return {"loop": name, "area": None, "kind": kind, "appeared": appeared, "blocks": blocks, "since_ms": 1.7e12, "words": "the words", "remedy": "the remedy"}


def show(open_page, daemon, obstacles, loops, trend=()):
    page = open_page(daemon)
    judged = loops - sum(o["blocks"] for o in obstacles)
    answer = json.dumps({"loops": loops, "judged": judged, "share": judged / loops, "obstacles": obstacles, "trend": trend})
    page.route("**/api/v1/obstacles", lambda route: route.fulfill(body=answer, content_type="application/json"))
    page.goto(f"http://{daemon.web}/#/obstacles")
    return page


def test_a_plant_without_obstacles_can_be_judged_whole(plant, open_page):
    page = show(open_page, plant, [], 4)
    expect(page.get_by_text("100 % of all loops can be judged (4 of 4)")).to_be_visible()
    expect(page.get_by_text("Nothing keeps a loop from being judged.")).to_be_visible()
    expect(page.locator("nav a[aria-current=page]")).to_have_text("Data")


def test_each_obstacle_has_its_words_and_its_remedy(plant, open_page, axe_source):
    page = show(open_page, plant, [obstacle(NAME, "swapped"), obstacle("FIC7", "compressed", blocks=False)], 4)
    expect(page.get_by_text("75 % of all loops can be judged (3 of 4)")).to_be_visible()
    rows = page.locator("tbody tr")
    expect(rows.nth(0).locator("a")).to_have_text(NAME)
    expect(rows.nth(0)).to_contain_text("OP and PV swapped")
    expect(rows.nth(1)).to_contain_text("judged, but less surely")
    expect(rows.nth(1)).to_contain_text("The remedy")
    if axe_source:
        found = page.evaluate("axe.run().then(r => r.violations.map(v => v.id))")
        assert found == []


def test_a_loop_that_never_sent_leads_nowhere(plant, open_page):
    page = show(open_page, plant, [obstacle(NAME, "silent", appeared=False)], 4)
    head = page.locator("tbody th").first
    expect(head).to_have_text(NAME)
    expect(head.locator("a")).to_have_count(0)


def test_the_share_over_time_is_a_chart_with_its_numbers_as_a_table(plant, open_page, axe_source):
    trend = [{"t_ms": 1.7e12 + 3.6e6 * k, "judged": 2 + k % 2, "loops": 4, "share": (2 + k % 2) / 4} for k in range(5)]
    page = show(open_page, plant, [], 4, trend)
    chart = page.get_by_role("group", name="Share of loops that can be judged", exact=True)
    expect(chart.locator("canvas")).to_be_visible()
    chart.get_by_text("Values as a table").click()
    rows = chart.locator("tbody tr")
    expect(rows).to_have_count(5)
    expect(rows.nth(0)).to_contain_text("50")
    expect(rows.nth(1)).to_contain_text("75")
    if axe_source:
        found = page.evaluate("axe.run().then(r => r.violations.map(v => v.id))")
        assert found == []
