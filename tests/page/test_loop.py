"""One loop's page: its charts, commands and downloads."""

import csv
import json
import re

import pytest
from conftest import PREFIX, api, loop_path
from mcap.reader import make_reader
from playwright.sync_api import expect

from daemon import eventually, stiction_lab, stictiond

LOOP = "FIC101"
PATH = f"#/loop/{LOOP}"
CHART = f"Process variable of {LOOP}"


@pytest.fixture
def page(plant, open_page):
    page = open_page(plant, PATH)
    expect(page.get_by_role("heading", level=1)).to_contain_text(LOOP)
    chart(page).scroll_into_view_if_needed()
    eventually("the trend", lambda: inked(page) > 500)
    return page


def chart(page):
    return page.get_by_role("group", name=CHART, exact=True)


def plot(page):
    return chart(page).get_by_role("application")


def inked(page):
    """Number of drawn pixels of the chart."""
    return chart(page).locator("canvas").evaluate("""(canvas) => {
      const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
      let n = 0;
      for (let k = 3; k < data.length; k += 4) n += data[k] > 128;
      return n;
    }""")


def shown(page):
    """First and last time on the axis, from the table of values."""
    fold = chart(page).get_by_text("Values as a table")
    details = chart(page).locator("details")
    times = details.locator("tbody th")
    if details.get_attribute("open") is not None:
        fold.click()
    # A folded table is empty, so the next reading cannot be outdated.
    expect(times).to_have_count(0)

    # It is redrawn with every sample, so a click may hit the previous one.
    def unfolded():
        if details.get_attribute("open") is None:
            fold.click()
        return times.count() > 0

    eventually("the table of values", unfolded)
    return times.first.inner_text(), times.last.inner_text()


def part(page, title):
    """A section of the page by its title, brought onto the screen."""
    section = page.get_by_role("region", name=title, exact=True)
    section.scroll_into_view_if_needed()
    return section


def test_a_table_opened_before_its_data_fills_when_they_come(page):
    held, holds = [], True
    page.route("**/window", lambda route: held.append(route) if holds else route.continue_())
    page.reload()
    chart(page).get_by_text("Values as a table").click()
    times = chart(page).locator("details tbody th")
    expect(times).to_have_count(0)
    holds = False
    while held:
        held.pop().continue_()
    expect(times).not_to_have_count(0)


def test_the_trend_grows_zooms_pans_and_tells_values(plant, page):
    whole = shown(page)
    eventually("a newer sample on the axis", lambda: shown(page)[1] > whole[1])
    box = plot(page).bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.6, box["y"] + box["height"] * 0.4)
    expect(chart(page)).to_contain_text(re.compile(r"\d\d:\d\d:\d\d"))
    expect(chart(page).get_by_role("button", name="PV", exact=True)).to_contain_text(re.compile(r"\d\d\.\d"))

    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.8, box["y"] + box["height"] * 0.4, steps=5)
    page.mouse.up()
    zoomed = shown(page)
    assert whole[0] < zoomed[0] <= zoomed[1], (whole, zoomed)
    plot(page).focus()
    page.keyboard.press("Shift+ArrowLeft")
    panned = shown(page)
    # The window moves on in the meantime and drops its first samples, so compare the last one.
    assert panned[1] < zoomed[1], (zoomed, panned)
    chart(page).get_by_role("button", name=f"Zoom in: {CHART}").click()
    assert shown(page)[1] < panned[1]
    plot(page).focus()
    page.keyboard.press("ArrowLeft")
    expect(chart(page).locator("[aria-live=polite]")).to_contain_text(re.compile(r"\d\d:\d\d:\d\d: .*PV .*\d"))
    page.keyboard.press("0")
    eventually("all of it again", lambda: shown(page)[1] > zoomed[1])


def test_ranges_load_the_recorded_past(plant, page):
    window = shown(page)
    ranges = page.get_by_role("group", name="Range", exact=True)
    with page.expect_response(re.compile("/trend")) as answered:
        ranges.get_by_role("button", name="8 h", exact=True).click()
    trend = answered.value.json()
    assert answered.value.ok and trend["complete"] is True
    spans = [t for t in trend["t_ms"]]
    assert spans[0] <= plant.plant.start_s * 1000 + 30_000 and spans[-1] - spans[0] >= 2990_000, (spans[0], spans[-1])
    assert len(spans) == len(trend["op"]) == len(trend["pv"]) <= 3300
    eventually("an earlier beginning", lambda: shown(page)[0] < window[0])
    expect(ranges.get_by_role("button", name="8 h", exact=True)).to_have_attribute("aria-pressed", "true")


def test_the_phase_plot_shifts_by_keyboard(page):
    slider = page.get_by_role("slider", name=re.compile("Shift PV"))
    drawn = lambda: page.get_by_role("img", name=re.compile("Phase plot")).locator("path").evaluate_all("(p) => p.map((x) => x.getAttribute('d')).join()")
    # The first plot sets the slider to the fitted dead time; before it, Home would move nothing.
    eventually("the phase plot", lambda: len(drawn()) > 1000)
    slider.focus()
    page.keyboard.press("Home")
    assert slider.input_value() == "0"
    before = drawn()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert slider.input_value() == "3"
    assert drawn() != before
    expect(slider).to_have_attribute("aria-valuetext", re.compile("[1-9] s"))


def test_history_reasons_and_pictures_appear(page):
    history = part(page, "Over time")
    expect(history.get_by_role("group", name=re.compile("^s over time"))).to_be_visible()
    expect(history.locator("canvas").first).to_be_visible()
    expect(part(page, "Why")).to_contain_text(re.compile(r"[a-z]{4,}"))
    pictures = part(page, "Pictures")
    images = pictures.get_by_role("img")
    expect(images.nth(5)).to_be_attached()
    for k in range(images.count()):
        images.nth(k).scroll_into_view_if_needed()
        expect(images.nth(k)).to_have_attribute("aria-label", re.compile("..."))
    expect(pictures).not_to_contain_text("could not be loaded")
    repair = part(page, "Benefit of a repair")
    expect(repair).to_contain_text(re.compile("Reversals a day|cannot|not good enough|choose a"), timeout=60_000)


def saved(page, link, folder):
    with page.expect_download() as download:
        page.get_by_role("link", name=link).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path


def test_the_window_is_saved_as_csv_and_mcap(plant, page, tmp_path):
    window = lambda: api(plant, loop_path(LOOP))["estimate"]["window"]
    for _ in range(2):
        before = window()
        table, recording = saved(page, "Window as CSV", tmp_path), saved(page, "Window as MCAP", tmp_path)
        if window() == before:
            break
    assert table.suffix == ".csv" and recording.suffix == ".mcap"
    start_s, end_s = before["start_ns"] / 1e9, before["end_ns"] / 1e9
    with table.open(newline="") as file:
        rows = [row for row in csv.DictReader(file)]
    times = [float(row["t"]) for row in rows]
    assert start_s <= times[0] <= start_s + 2 and end_s - 2 <= times[-1] <= end_s, (times[0], times[-1], before)
    assert len(rows) >= 0.99 * (end_s - start_s)
    published = {plant.plant.start_s + k: (op, pv) for k, (op, pv) in enumerate(zip(plant.plant.loops[LOOP].op, plant.plant.loops[LOOP].pv))}
    for row in rows[::50]:
        op, pv = published[round(float(row["t"]))]
        assert abs(float(row["op"]) - op) < 1e-3 and abs(float(row["pv"]) - pv) < 1e-3, row
    with recording.open("rb") as file:
        held = {}
        for _, channel, message in make_reader(file).iter_messages():
            if "@" not in channel.topic:
                held.setdefault(channel.topic, []).append(message.publish_time / 1e9)
    assert set(held) == {f"{PREFIX}/{LOOP}/op", f"{PREFIX}/{LOOP}/pv"}, set(held)
    for stamps in held.values():
        assert start_s <= min(stamps) and max(stamps) <= end_s and len(stamps) >= 0.99 * (end_s - start_s)
    code, out, said = stictiond("analyze", recording, "--format", "json")
    assert code == 0 and json.loads(out.splitlines()[0])["stiction"] is True, (out, said)


def test_the_evidence_sheet_opens_and_prints(page):
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="Evidence sheet").click()
    sheet = opened.value
    sheet.wait_for_load_state()
    expect(sheet.get_by_role("main").or_(sheet.locator("body")).first).to_contain_text(LOOP)
    assert sheet.locator("svg").count() >= 5
    paper = sheet.pdf()
    pages = len(re.findall(rb"/Type\s*/Page\b", paper))
    assert paper.startswith(b"%PDF") and 1 <= pages <= 20, pages


def test_a_diagnosis_that_somebody_else_asked_for_appears(plant, page):
    address = f"http://{plant.web}/api/v1{loop_path(LOOP)}/gap"
    answer = page.request.post(address, headers={"X-Stictiond": "1", "Authorization": f"Bearer {plant.token}"}, data={"by": "Bob"}, timeout=90_000)
    assert answer.ok, answer.text()
    expect(part(page, "Gap: what the model misses")).to_contain_text("Which", timeout=60_000)


def test_the_gap_diagnosis_runs_from_its_button(plant, page):
    gap = part(page, "Gap: what the model misses")
    gap.get_by_role("button", name=re.compile("^Run the diagnosis")).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Your name").fill("Ann")
    dialog.get_by_role("button", name="Run").click()
    expect(gap.get_by_role("status")).to_contain_text("Done", timeout=90_000)
    words = api(plant, loop_path(LOOP))["words"]["gap"]
    expect(gap).to_contain_text(words[1:60])
    expect(gap.get_by_role("table", name=re.compile("^What PV is made of"))).to_contain_text("measurement noise")


def test_a_repair_is_kept_with_the_time_of_the_work(plant, page):
    page.get_by_role("button", name=f"Repaired: {LOOP}").first.click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Your name").fill("Ann")
    dialog.get_by_label("Work done at").fill("2026-01-05T08:30")
    dialog.get_by_label("Reason").fill("packing replaced")
    dialog.get_by_role("button", name="Keep").click()
    expect(dialog).to_have_count(0)
    expect(page.get_by_role("main")).to_contain_text("Repaired on 5 Jan 2026, 08:30, says Ann.")
    kept = [review for review in api(plant, "/reviews")["reviews"] if review["loop"] == LOOP][-1]
    assert (kept["label"], kept["work_at"], kept["why"]) == ("repaired", "2026-01-05T08:30:00Z", "packing replaced"), kept


def test_a_review_is_kept_and_evaluate_takes_it(plant, page):
    page.get_by_role("button", name=re.compile(rf"^(Confirm|Confirm by stroke test).*: {LOOP}")).first.click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Your name").fill("Ann <b>")
    dialog.get_by_label("How it was found").select_option("stroke_test")
    dialog.get_by_label("Reason").fill('stem moved after 6 %, "twice", and, late')
    dialog.get_by_role("button").last.click()
    expect(dialog).to_have_count(0)
    expect(page.get_by_role("main")).to_contain_text("Confirmed by Ann <b>")
    index = plant.recordings / "reviews" / "INDEX.csv"
    with index.open(newline="") as file:
        kept = [row for row in csv.DictReader(file) if row["loop"] == LOOP]
    assert kept[-1]["by"] == "Ann <b>" and kept[-1]["why"] == 'stem moved after 6 %, "twice", and, late', kept
    code, out, said = stiction_lab("evaluate", index)
    assert code == 0 and re.search(r"1\b", out), (out, said)
    print("\n" + "\n".join(f"  {line}" for line in out.splitlines()[:6]))
    assert plant.get("/api/v1/reviews.csv") == index.read_text()
