"""The workbench: files in a browser, with the numbers of the command line, and uploads that mean harm."""

import json
import re
import socket
import subprocess
import time

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

    def __init__(self, folder):
        self.log = folder / "log"
        arguments = [PROGRAM, "workbench", RECORDING, "--no-open", "--listen", "127.0.0.1:0"]
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
    page.get_by_role("region", name="Trend and sections").get_by_role("button", name=button, exact=True).click()
    row = page.get_by_role("region", name="Runs compared").get_by_role("row").filter(has_text=f"Run {number}")
    expect(row.first).to_be_visible()
    return row


def newest(bench):
    return api(bench, "/workbench/jobs")["jobs"][-1]


def over(bench):
    job = newest(bench)
    return job if job["state"] in ("done", "failed", "cancelled") else None


def test_an_estimate_has_the_numbers_of_analyze_to_the_digit(bench, page):
    run(page, "Estimate", 1)
    result = page.get_by_role("region", name="Result")
    job = eventually("the run's end", lambda: over(bench), within=90)
    assert job["state"] == "done", job
    expect(page.get_by_role("status").filter(has_text="Run 1: done")).to_be_attached()
    # Pictures are drawn when they come near the screen.
    expect(result.get_by_role("heading", name="Pictures")).to_be_visible()
    page.get_by_role("region", name="Runs compared").scroll_into_view_if_needed()
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
    before = newest(bench)["id"] if api(bench, "/workbench/jobs")["jobs"] else None
    page.get_by_role("region", name="Trend and sections").get_by_role("button", name="Estimate", exact=True).click()
    eventually("a new run", lambda: api(bench, "/workbench/jobs")["jobs"] and newest(bench)["id"] != before)
    job = eventually("the run's end", lambda: over(bench))
    code, out, said = stictiond("analyze", RECORDING, "--samples", f"{a},{b}", "--model", "fopdt", "--format", "json")
    assert code == 0, said
    wanted, found = json.loads(out.splitlines()[0]), job["results"][0]["document"]
    assert [wanted[k] for k in ("window", "fs", "fd", "s_interval", "p_stiction")] == [found[k] for k in ("window", "fs", "fd", "s_interval", "p_stiction")]


def test_a_file_is_opened_and_what_cannot_be_read_says_why(bench, open_page, tmp_path):
    # A browser notes a refusal, whatever the page makes of it.
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


def posted(bench, path, headers, body=b""):
    """Sends a request by hand, and gives status and body."""
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
    # More than is ever taken is refused before it is sent.
    status, body = posted(bench, f"{UPLOADS}?name=a.csv", {**BODY, "Content-Length": str(300 << 20)})
    assert status == 413 and "error" in json.loads(body), (status, body)
    # A name is a name, never a way.
    status, body = posted(bench, f"{UPLOADS}?name=..%2F..%2F..%2Fetc%2Fpasswd.csv", {**BODY, **length}, table)
    assert status in (200, 422), (status, body)
    if status == 200:
        assert "/" not in json.loads(body)["name"], body
        for one in api(bench, "/workbench/files")["files"][len(before):]:
            assert "/" not in one["name"] or not one["name"].startswith(".."), one["name"]
    for path in ("/workbench/files/..%2f..%2fetc", "/workbench/files/1/record?loop=../../x", "/workbench/jobs/..%2f1"):
        with pytest.raises(OSError):
            bench.get(f"/api/v1{path}")


def test_a_slow_upload_is_cut_off(bench):
    host, port = bench.web.split(":")
    with socket.create_connection((host, int(port)), timeout=1) as s:
        started = time.monotonic()
        head = [f"POST {UPLOADS}?name=slow.csv HTTP/1.1", f"Host: {bench.web}", "Content-Length: 100000"]
        s.sendall("\r\n".join([*head, *(f"{k}: {v}" for k, v in BODY.items()), "", ""]).encode())
        answer = b""
        while not answer and time.monotonic() - started < 40:
            try:
                s.sendall(b"1")
                answer = s.recv(4096) or b"closed"
            except TimeoutError:
                continue
            except OSError:
                break
    taken = time.monotonic() - started
    print(f"\n  a slow upload is cut off after {taken:.0f} s")
    assert taken < 30, answer
