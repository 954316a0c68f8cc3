"""The plant view: groups of loops that share one oscillation. The daemon's answer is replaced if a group is needed."""

import json

from playwright.sync_api import expect

NAME = "<b>TIC102</b>"
TIME = {"start_ns": 0, "end_ns": 0, "start": "2026-01-05T08:00:00Z", "end": "2026-01-05T09:00:00Z"}


def judged(name, cause=None, masked=False):
    return {"loop": name, "p_source": 0.9, "p_alone": 0.8, "p_stiction": 0.2, "cause": cause, "masked": masked}


def group(kind="loop", next_test=None):
    source = {"kind": kind, "loop": None if kind == "outside" else "FIC101", "probability": 0.94, "reasons": ["a reason"], "next_test": next_test}
    document = {
        "members": ["FIC101", NAME], "source": source, "period_s": 184, "p_value": 0.001, "window": TIME,
        "followers": [{"loop": NAME, "lag_s": 12.0, "share": 0.8}],
        "judgements": [judged("FIC101"), judged(NAME, "driven by FIC101, p 0.94", masked=True)],
    }
    history = [
        {"t_ms": 1.7e12, "members": ["FIC101", "LIC103"], "source": None},
        {"t_ms": 1.7e12 + 6e5, "members": ["FIC101", NAME], "source": "FIC101"},
    ]
    return {"id": 7, "document": document, "history": history}


def show(open_page, daemon, groups, path="#/groups", **options):
    page = open_page(daemon, **options)
    answer = json.dumps({"compared_age_s": 1.0, "groups": groups})
    page.route("**/api/v1/groups", lambda route: route.fulfill(body=answer, content_type="application/json"))
    page.goto(f"http://{daemon.web}/{path}")
    return page


def test_without_groups_the_view_says_what_that_means(plant, open_page):
    page = show(open_page, plant, [])
    expect(page.get_by_text("No loops share an oscillation. Each loop is judged on its own.")).to_be_visible()
    expect(page.locator("nav a[aria-current=page]")).to_have_text("Plant")


def test_a_card_names_the_source_and_what_a_masked_loop_needs(plant, open_page, axe_source):
    page = show(open_page, plant, [group()])
    card = page.locator("article.group")
    expect(card.locator("h2")).to_have_text("FIC101 causes the oscillation, p 0.94")
    follower = card.locator("tbody tr").nth(1)
    expect(follower).to_contain_text("not cleared: judge again once FIC101 is repaired")
    expect(follower.locator("a")).to_have_text(NAME)
    card.locator("summary").focus()
    page.keyboard.press("Enter")
    expect(card.locator("li time")).to_have_count(2)
    expect(card.locator("ol li").nth(1)).to_contain_text(f"{NAME} joined; LIC103 left; source: FIC101")
    if axe_source:
        found = page.evaluate("axe.run().then(r => r.violations.map(v => v.id))")
        assert found == []


def test_other_sources_are_in_plain_words(plant, open_page):
    page = show(open_page, plant, [group("outside")])
    expect(page.locator("article h2")).to_contain_text("look upstream")
    page = show(open_page, plant, [group("cannot_tell", "Put FIC101 in manual.")])
    expect(page.locator("article h2")).to_have_text("The windows do not show which loop causes the oscillation: FIC101 is the likeliest")
    expect(page.locator("article .todo")).to_have_text("Next test: Put FIC101 in manual.")


def test_a_narrow_screen_scrolls_the_table_alone(plant, open_page):
    page = show(open_page, plant, [group()], viewport={"width": 400, "height": 800})
    expect(page.locator("article.group")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_the_address_of_a_loop_leads_to_its_group(plant, open_page):
    page = show(open_page, plant, [group()], path="#/groups?loop=FIC101")
    expect(page.locator("article.group")).to_be_focused()
