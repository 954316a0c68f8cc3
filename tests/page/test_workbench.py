"""The workbench: files in a browser, with the numbers of the command line, and malicious uploads."""

import json
import re
import socket
import subprocess

import pytest
from conftest import api, skipped
from playwright.sync_api import expect

from daemon import PROGRAM, ROOT, Daemon, eventually, stictiond

RECORDING = ROOT / "recordings" / "sticking.mcap"
UPLOADS = "/api/v1/workbench/files"
BODY = {"X-Stictiond": "1", "Content-Type": "application/octet-stream"}


class Bench:
    """`stictiond workbench` with a recording."""

    get = Daemon.get

    def __init__(self, folder, recording=RECORDING):
        self.log = folder / "log"
        arguments = [PROGRAM, "workbench", recording, "--no-open", "--listen", "127.0.0.1:0"]
        with self.log.open("w") as log:
            self.process = subprocess.Popen(arguments, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        found = eventually("the workbench", lambda: re.search(r"http://(127\.0\.0\.1:\d+)", self.log.read_text()), 30)
        self.web = found[1]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    if stictiond("workbench", "--help")[0] != 0:
        skipped("this program has no workbench: it was not looked at")
        pytest.skip("no workbench")
    running = Bench(tmp_path_factory.mktemp("bench"))
    yield running
    running.process.terminate()
    assert running.process.wait(timeout=15) == 0, running.log.read_text()[-2000:]


@pytest.fixture
def page(bench, open_page):
    page = open_page(bench)
    expect(page.get_by_role("heading", name="Workbench", level=1)).to_be_visible()
    expect(page.get_by_role("heading", name="Trend of FIC101")).to_be_visible()
    return page


def run(page, button, number):
    page.get_by_role("region", name="Settings").get_by_role("button", name=button, exact=True).click()
    row = page.get_by_role("region", name="Runs compared").get_by_role("row").filter(has_text=f"Run {number}")
    expect(row.first).to_be_visible()
    return row


def newest(bench):
    return api(bench, "/workbench/jobs")["jobs"][-1]


def over(bench):
    job = newest(bench)
    return job if job["state"] in ("done", "failed", "cancelled") else None


def test_an_estimate_has_the_numbers_of_analyze_to_the_digit(bench, page):
    run(page, "Run estimate", 1)
    result = page.get_by_role("region", name="Result")
    job = eventually("the run's end", lambda: over(bench), within=90)
    assert job["state"] == "done", job
    expect(page.get_by_role("status").filter(has_text="Run 1: done")).to_be_attached()
    # Pictures are drawn when they come near the screen.
    page.get_by_role("button", name="Result", exact=True).click()
    result.get_by_role("heading", name="Pictures").scroll_into_view_if_needed()
    expect(result.get_by_role("img").first).to_be_attached()
    for found, model in zip(job["results"], ("fopdt", "sopdt"), strict=True):
        code, out, said = stictiond("analyze", RECORDING, "--model", model, "--format", "json")
        assert code == 0, said
        wanted = json.loads(out.splitlines()[0])
        differing = [key for key in wanted if key != "elapsed_ms" and wanted[key] != found["document"][key]]
        assert not differing, (model, differing)
    shown = f"{job['results'][0]['document']['s']:.1f}"
    expect(result).to_contain_text(shown)
    with page.expect_download() as download:
        result.get_by_role("link", name=re.compile("^Save report")).first.click()
    assert b"FIC101" in download.value.path().read_bytes()


def test_choices_are_undone_redone_and_a_run_is_cancelled(bench, page):
    process = page.get_by_label("Process", exact=True)
    before = process.input_value()
    process.select_option("sopdt")
    page.get_by_role("button", name="↶ Undo").click()
    expect(process).to_have_value(before)
    page.get_by_role("button", name="↷ Redo").click()
    expect(process).to_have_value("sopdt")
    page.get_by_role("group", name="Kind of run").get_by_role("button", name="Gap").click()
    page.get_by_role("button", name="Diagnose the gap").click()
    expect(page.get_by_role("progressbar", name=re.compile("^Progress of run"))).to_be_visible()
    page.get_by_role("button", name="Cancel").last.click()
    job = eventually("the cancelled run's end", lambda: over(bench), within=30)
    assert job["state"] == "cancelled" and job["request"]["kind"] == "gap", job["state"]


def test_a_section_is_dragged_and_counts(bench, page):
    page.get_by_role("group", name="What dragging does").get_by_role("button").filter(has_text=re.compile("[Ss]ection|[Cc]hoose")).first.click()
    plot = page.get_by_role("region", name="Trend and sections").get_by_role("application").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] * 0.3, y)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.8, y, steps=8)
    page.mouse.up()
    first, last = (page.get_by_label(re.compile(f"^Section 1, {end} sample")) for end in ("first", "last"))
    a, b = int(first.input_value()), int(last.input_value())
    assert 300 < a < 800 and 1300 < b < 1800, (a, b)
    page.get_by_label("Process", exact=True).select_option("fopdt")
    page.get_by_text("Solver, fineness, seed").click()
    page.get_by_label("Additional solver").select_option("contour")
    before = newest(bench)["id"] if api(bench, "/workbench/jobs")["jobs"] else None
    page.get_by_role("button", name="Run estimate").click()
    eventually("a new run", lambda: api(bench, "/workbench/jobs")["jobs"] and newest(bench)["id"] != before)
    job = eventually("the run's end", lambda: over(bench))
    code, out, said = stictiond("analyze", RECORDING, "--samples", f"{a},{b}", "--model", "fopdt", "--format", "json")
    assert code == 0, said
    wanted, found = json.loads(out.splitlines()[0]), job["results"][0]["document"]
    assert [wanted[k] for k in ("window", "fs", "fd", "s_interval", "p_stiction")] == [found[k] for k in ("window", "fs", "fd", "s_interval", "p_stiction")]
    errors_and_maps_are_explained(page.get_by_role("region", name="Result"), page, job["results"][0])


def errors_and_maps_are_explained(result, page, found):
    document = found["document"]
    rows = result.get_by_role("region", name="Mean squared errors").get_by_role("row")
    for row, name, error in [(1, "Estimate", document["process"]["mse"]), (3, "Best of contour", document["solver"]["mse"])]:
        expect(rows.nth(row)).to_contain_text(name)
        assert float(rows.nth(row).get_by_role("cell").nth(2).inner_text()) == pytest.approx(error, rel=0.01)
    expect(result.get_by_text(re.compile("Use the estimate"))).to_be_visible()
    region = next(m for m in found["maps"] if m["order"] == 1)
    for name, values in [("OP's span, S0", [document["s0"]]), ("Suggested region, fs", region["fs"]), ("Suggested region, fd", region["fd"])]:
        shown = result.get_by_role("row").filter(has_text=name).get_by_role("cell").first.inner_text()
        assert [float(v) for v in re.findall(r"[\d.]+", shown)] == pytest.approx(values, rel=0.01), (name, shown)
    # Values under the pointer.
    figure = result.locator("figure").filter(has_text="Error map, He's law, order 1.")
    figure.scroll_into_view_if_needed()
    picture = figure.get_by_role("img")
    picture.scroll_into_view_if_needed()
    picture.hover(position={"x": picture.bounding_box()["width"] * 0.35, "y": picture.bounding_box()["height"] * 0.55})
    expect(page.locator(".value-box")).to_have_text(re.compile(r"^fs [\d.]+, fd [\d.]+: rms [\d.]+ % of std$"))


def test_what_a_run_analyses_is_seen_before_it_and_help_explains_every_field(bench, page):
    trend = page.get_by_role("region", name="Trend and sections")
    expect(trend).to_contain_text(re.compile(r"As recorded and as analysed: 2,000 points, one every 1 s\..*S0 = 12\.8 OP units"))
    expect(trend.get_by_role("img", name=re.compile("phase plot: OP from"))).to_have_count(1)
    plots = trend.locator(".wb-plots")
    for axes, charts, right in [("Two axes", 1, 1), ("One axis", 1, 0), ("Two charts", 2, 0)]:
        trend.get_by_role("button", name=axes).click()
        expect(plots.get_by_role("application")).to_have_count(charts)
        # Besides the time axis, every chart has an axis on the left, and one on the right if there are two.
        expect(plots.locator(".u-axis")).to_have_count(2 * charts + right)
    # The choice of axes is a step like any other.
    page.get_by_role("button", name="↶ Undo").click()
    expect(trend.get_by_role("button", name="One axis")).to_have_attribute("aria-pressed", "true")
    expect(plots.get_by_role("application")).to_have_count(1)
    page.get_by_role("button", name="↷ Redo").click()
    expect(plots.get_by_role("application")).to_have_count(2)
    page.keyboard.press("?")
    help = page.get_by_role("dialog", name="Help")
    explained = help.inner_text()
    for label in page.locator(".wb-form label:visible").all_inner_texts():
        assert label.split(",")[0] in explained or label in ("From", "To"), label
    help.get_by_role("region", name="Example 2").get_by_role("button", name="Set the choices").click()
    expect(help).to_have_count(0)
    expect(trend).to_contain_text(re.compile(r"As recorded: 451 points, one every 1 s\..*As analysed: 225 points, one every 2 s\."))
    expect(trend.get_by_role("img", name=re.compile("phase plot: OP from"))).to_have_count(2)
    page.get_by_role("button", name="↶ Undo").click()
    expect(trend).to_contain_text("As recorded and as analysed: 2,000 points")


def test_a_file_is_opened_and_what_cannot_be_read_says_why(bench, open_page, tmp_path):
    # The browser logs a refusal, however the page handles it.
    page = open_page(bench, lossy="422")
    name = "<img src=x onerror=alert(1)> & more.csv"
    rows = ["t,op,pv"] + [f"{k},{50 + k % 40},{60 - k % 40}" for k in range(400)]
    (tmp_path / name).write_text("\n".join(rows))
    (tmp_path / "junk.csv").write_bytes(bytes(range(256)) * 40)
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=re.compile("^Open a file")).click()
    chooser.value.set_files([tmp_path / name])
    files = page.get_by_role("region", name="Files")
    expect(files).to_contain_text(name)
    assert page.locator("img[src='x'], img[onerror]").count() == 0
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=re.compile("^Open a file")).click()
    chooser.value.set_files([tmp_path / "junk.csv"])
    expect(files).to_contain_text(re.compile(r"junk\.csv: .{10,}"))
    page.get_by_role("button", name=f"Close {name}").click()
    expect(files).not_to_contain_text(name)
    # A store's loops are numbered; their tags identify them.
    store = tmp_path / "store.mat"
    code, _, said = stictiond("convert", RECORDING, store)
    assert code == 0, said
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=re.compile("^Open a file")).click()
    chooser.value.set_files([store])
    expect(page.get_by_role("heading", name="Trend of FIC101 (loop1)")).to_be_visible()
    known = page.locator(".wb-process")
    expect(known).to_contain_text(re.compile(r"Loop\s*FIC101 \(loop1\)\s*Sampling time\s*1 s\s*Samples\s*2,000"))
    expect(page.get_by_role("img", name=re.compile("phase plot: OP from"))).to_be_visible()
    page.get_by_role("button", name="Close store.mat").click()
    expect(known).to_be_hidden()


BROKEN_WORDS = """() => {
  const broken = [];
  const texts = document.createTreeWalker(document.querySelector(".wb"), NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode;
    if (!text.parentElement.checkVisibility() || text.parentElement.closest("svg, pre, .unseen, .wb-file h3")) continue;
    for (const { 0: word, index } of text.data.matchAll(/\\p{L}{2,}/gu)) {
      const range = document.createRange();
      range.setStart(text, index);
      range.setEnd(text, index + word.length);
      if (new Set([...range.getClientRects()].map((r) => Math.round(r.top))).size > 1) broken.push(word);
    }
  }
  return broken;
}"""
EMPTY_COLUMNS = """() => [0.1, 0.3, 0.5, 0.7, 0.9].filter((x) => ![0.3, 0.4, 0.5].some((y) =>
  document.elementFromPoint(x * innerWidth, y * innerHeight)?.closest(".card")))"""


def test_at_every_width_words_stay_whole_choices_in_view_and_no_column_empty(bench, open_page):
    page = open_page(bench)
    go = page.get_by_role("button", name=re.compile("^Run estimate"))
    if not api(bench, "/workbench/jobs")["jobs"]:
        go.click()
    page.get_by_role("button", name="Run 1", exact=True).click()
    expect(page.get_by_role("region", name="Result").get_by_role("heading", name="Pictures")).to_be_visible()
    for width in (390, 1000, 1400, 1900):
        page.set_viewport_size({"width": width, "height": 900})
        page.evaluate("scrollTo(0, 0)")
        tops = [page.get_by_role("region", name=name).bounding_box()["y"] for name in ("Runs compared", "Trend and sections", "Result")]
        assert tops == sorted(tops), (width, tops)
        for share in (0, 0.5, 0.9):
            page.evaluate(f"scrollTo(0, {share} * document.documentElement.scrollHeight)")
            expect(go).to_be_in_viewport(ratio=0.99)
            go.click(trial=True)
            assert page.evaluate(EMPTY_COLUMNS) == [], (width, share)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
        assert page.evaluate(BROKEN_WORDS) == [], width
    page.set_viewport_size({"width": 390, "height": 900})
    page.get_by_role("button", name="Choices").click()
    expect(page.get_by_label("Process", exact=True)).to_be_in_viewport()


def posted(bench, path, headers, body=b""):
    """Sends a hand-made request; returns status and body."""
    host, port = bench.web.split(":")
    with socket.create_connection((host, int(port)), timeout=30) as s:
        headers = {"Host": bench.web, "Connection": "close", **headers}
        lines = [f"POST {path} HTTP/1.1", *(f"{k}: {v}" for k, v in headers.items())]
        s.sendall("\r\n".join([*lines, "", ""]).encode() + body)
        answer = b""
        try:
            while part := s.recv(65536):
                answer += part
        except ConnectionError:
            pass
    status = re.match(rb"HTTP/1.1 (\d+)", answer)
    return int(status[1]) if status else None, answer.partition(b"\r\n\r\n")[2]


def test_uploads_that_mean_harm_are_refused(bench):
    before = api(bench, "/workbench/files")["files"]
    table = b"t,op,pv\n" + b"".join(b"%d,%d,%d\n" % (k, k % 9, k % 7) for k in range(100))
    length = {"Content-Length": str(len(table))}
    for headers, wanted in [
        ({}, 403), ({**BODY, "Origin": "http://evil.example"}, 403), ({**BODY, "Sec-Fetch-Site": "cross-site"}, 403),
        ({**BODY, "Host": "evil.example"}, 421),
    ]:
        status, body = posted(bench, f"{UPLOADS}?name=a.csv", {**length, **headers}, table)
        assert status == wanted, (headers, status, body)
    for query, wanted in [("", (400, 422)), ("?name=a.csv&tz=Nowhere", (400, 422)), ("?name=a.csv&evil=1", (200, 400, 422))]:
        status, body = posted(bench, UPLOADS + query, {**BODY, **length}, table)
        assert status in wanted, (query, status, body)
    # A size above the limit is refused before the data are sent.
    status, body = posted(bench, f"{UPLOADS}?name=a.csv", {**BODY, "Content-Length": str(300 << 20)})
    assert status == 413 and "error" in json.loads(body), (status, body)
    # A file name is never used as a path.
    status, body = posted(bench, f"{UPLOADS}?name=..%2F..%2F..%2Fetc%2Fpasswd.csv", {**BODY, **length}, table)
    assert status in (200, 422), (status, body)
    if status == 200:
        assert "/" not in json.loads(body)["name"], body
        for one in api(bench, "/workbench/files")["files"][len(before):]:
            assert "/" not in one["name"] or not one["name"].startswith(".."), one["name"]
    for path in ("/workbench/files/..%2f..%2fetc", "/workbench/files/1/record?loop=../../x", "/workbench/jobs/..%2f1"):
        with pytest.raises(OSError):
            bench.get(f"/api/v1{path}")
