"""Attacks: foreign pages and machines, paths outside the folder, requests that never end, names that contain code."""

import http.client
import json
import re
import socket
import threading
import time

import pytest
from conftest import HOSTILE, LONG, TOKEN, api, loop_path, skipped
from playwright.sync_api import expect

from daemon import Daemon, eventually

COMMAND = json.dumps({"cmd": "suppress", "by": "Eve"})
SILENCE_S = 15
# Covers the limit for the head of a request (5 s) and the check for dead connections (every 5 s).
HEAD_WITHIN_S = 15


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A daemon without loops, open to the network, without a token."""
    daemon = Daemon(tmp_path_factory.mktemp("alone"), "alone", "")
    daemon.config.write_text(daemon.config.read_text().replace('listen = "127.0.0.1', 'listen = "0.0.0.0'))
    with daemon:
        yield daemon


@pytest.fixture(scope="module", autouse=True)
def stream(alone):
    """A stream that is read continuously: its bytes, and their times of arrival."""
    seen = {"at": [], "bytes": b"", "ended": None}

    def read():
        with connected(alone) as s:
            s.sendall(head("GET", "/api/v1/events", alone.web))
            s.settimeout(60)
            seen["from"] = time.monotonic()
            while part := s.recv(65536):
                seen["at"].append(time.monotonic())
                seen["bytes"] += part
            seen["ended"] = time.monotonic()

    threading.Thread(target=read, daemon=True).start()
    return seen


def connected(daemon, host="127.0.0.1"):
    return socket.create_connection((host, int(daemon.web.rsplit(":", 1)[1])), timeout=20)


def head(method, path, host, *more):
    return "\r\n".join([f"{method} {path} HTTP/1.1", f"Host: {host}", *more, "", ""]).encode()


def said(s):
    """All bytes until the other side closes or resets the connection."""
    whole = b""
    try:
        while part := s.recv(65536):
            whole += part
    except ConnectionError:
        pass
    return whole


def status(daemon, method, path, headers=None, body=None, host="127.0.0.1"):
    connection = http.client.HTTPConnection(host, int(daemon.web.rsplit(":", 1)[1]), timeout=20)
    connection.request(method, path, body, {"Content-Type": "application/json", **(headers or {})})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


def other_address():
    """This machine's network address, from which requests do not count as local."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        try:
            s.connect(("192.0.2.1", 9))
            own = s.getsockname()[0]
        except OSError:
            return None
    return None if own.startswith("127.") else own


def test_foreign_pages_and_names_command_nothing(plant):
    path = f"/api/v1{loop_path('TIC102')}/alarm"
    own = {"X-Stictiond": "1"}
    before = api(plant, loop_path("TIC102"))["alarm"]
    for headers, wanted in [
        ({}, 403),
        ({**own, "Origin": "http://evil.example"}, 403),
        ({**own, "Origin": f"https://evil.example/{plant.web}"}, 403),
        ({**own, "Sec-Fetch-Site": "cross-site"}, 403),
        ({**own, "Sec-Fetch-Site": "same-site"}, 403),
        ({**own, "Host": "evil.example"}, 421),
        ({**own, "Host": f"localhost.evil.example:{plant.web}"}, 421),
        ({**own, "X-Forwarded-For": "203.0.113.9"}, 401),
        ({**own, "X-Forwarded-For": "203.0.113.9", "Authorization": "Bearer wrong"}, 401),
    ]:
        got, body = status(plant, "POST", path, headers, COMMAND)
        assert got == wanted and "error" in json.loads(body), (headers, got, body)
    assert status(plant, "GET", "/api/v1/loops", {"Host": "evil.example"})[0] == 421
    # The token is needed even from this machine.
    assert status(plant, "POST", path, own, COMMAND)[0] == 401
    got, _ = status(plant, "POST", path, {**own, "Authorization": f"Bearer {TOKEN}", "Content-Type": "text/plain"}, COMMAND)
    assert got == 415
    assert status(plant, "OPTIONS", path, {"Origin": "http://evil.example", "Access-Control-Request-Method": "POST"})[0] >= 400
    assert api(plant, loop_path("TIC102"))["alarm"] == before


def test_other_machines_read_and_command_with_the_token_alone(plant, alone):
    own, far = {"X-Stictiond": "1"}, other_address()
    if far is None:
        skipped("this machine has no address but loopback: tokens were not tried from another machine")
        pytest.skip("no other address")
    path = f"/api/v1{loop_path('TIC102')}/alarm"
    assert status(plant, "GET", "/api/v1/site", host=far)[0] == 200
    assert json.loads(status(plant, "GET", "/api/v1/site", host=far)[1])["token"] == "needed"
    for headers, wanted in [
        (own, 401),
        ({**own, "Authorization": "Bearer "}, 401),
        ({**own, "Authorization": f"Bearer {TOKEN[:-1]}"}, 401),
        ({**own, "Authorization": f"Basic {TOKEN}"}, 401),
        ({"Authorization": f"Bearer {TOKEN}"}, 403),
        ({**own, "Authorization": f"Bearer {TOKEN}"}, 200),
    ]:
        got, body = status(plant, "POST", path, headers, COMMAND, far)
        assert got == wanted, (headers, got, body)
    back = json.dumps({"cmd": "unsuppress", "by": "Ann"})
    assert status(plant, "POST", path, {**own, "Authorization": f"Bearer {TOKEN}"}, back, far)[0] == 200
    # Without a configured token, nothing is accepted from outside, whatever is sent.
    assert json.loads(status(alone, "GET", "/api/v1/site", host=far)[1])["token"] == "refused"
    assert status(alone, "POST", path, {**own, "Authorization": "Bearer "}, COMMAND, far)[0] == 403


def test_a_token_is_asked_for_in_the_page(plant, open_page):
    far = other_address()
    if far is None:
        pytest.skip("no other address")

    class Far:
        web = f"{far}:{plant.web.rsplit(':', 1)[1]}"

    page = open_page(Far, f"#/loop/{'TIC102'}", lossy="401")
    page.get_by_role("button", name="Out of service: TIC102").click()
    dialog = page.get_by_role("dialog", name=re.compile("Out of service"))
    dialog.get_by_label("Your name").fill("Ann")
    dialog.get_by_role("button", name="Out of service").click()
    token = page.get_by_role("dialog", name="Token needed")
    token.get_by_label("Token").fill(TOKEN)
    token.get_by_role("button", name="Use it").click()
    expect(page.get_by_role("button", name="Back in service: TIC102")).to_be_visible()
    page.get_by_role("button", name="Back in service: TIC102").click()
    page.get_by_role("dialog").get_by_role("button", name="Back in service").click()
    expect(page.get_by_role("button", name="Out of service: TIC102")).to_be_visible()


@pytest.mark.parametrize("path", [
    "/../Cargo.toml", "/../../../../Cargo.toml", "/%2e%2e/%2e%2e/%2e%2e/Cargo.toml", "/vendor/..%2f..%2f..%2f..%2fCargo.toml",
    "/vendor/../../assets.rs", "/..%5c..%5cCargo.toml", "//etc/passwd", "/%2fetc%2fpasswd", "/vendor//..//../mod.rs",
    "/app.js%00.png", "/api/v1/../../mod.rs", "/api/v1/loops/..%2f..%2fCargo.toml/window.csv", "http://evil.example/../mod.rs",
])
def test_no_path_leads_out(alone, path):
    with connected(alone) as s:
        s.sendall(head("GET", path, alone.web, "Connection: close"))
        answer = said(s)
    assert re.match(rb"HTTP/1.1 4\d\d ", answer), answer[:300]
    assert not re.search(rb"\[package\]|root:|//!|fn ", answer), answer[:300]


def test_bodies_and_heads_that_are_too_large_are_refused(alone):
    path = f"/api/v1{loop_path('x')}/alarm"
    with connected(alone) as s:
        s.sendall(head("POST", path, alone.web, "X-Stictiond: 1", "Content-Type: application/json", "Content-Length: 50000000"))
        try:
            for _ in range(100):
                s.sendall(b"[" * 500_000)
        except OSError:
            pass
        answer = said(s)
    assert not answer or re.match(rb"HTTP/1.1 413 ", answer), answer[:300]
    with connected(alone) as s:
        try:
            s.sendall(head("GET", "/", alone.web, "X-Long: " + "a" * 300_000))
        except OSError:
            pass
        answer = said(s)
    assert not answer or re.match(rb"HTTP/1.1 431 ", answer), answer[:300]
    nested = b"[" * 200_000
    got, body = status(alone, "POST", path, {"X-Stictiond": "1"}, nested)
    assert got in (400, 413, 422) and "error" in json.loads(body), (got, body[:200])
    assert alone.healthz()


def test_a_head_that_never_ends_is_cut_off(alone):
    with connected(alone) as s:
        started = time.monotonic()
        s.settimeout(0.5)
        s.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")
        while time.monotonic() - started < 2 * HEAD_WITHIN_S:
            try:
                s.sendall(b"a")
                if not s.recv(1):
                    break
            except TimeoutError:
                continue
            except OSError:
                break
    taken = time.monotonic() - started
    print(f"\n  a slow head is cut off after {taken:.1f} s")
    assert taken < HEAD_WITHIN_S


def test_hundreds_of_idle_connections_do_not_keep_others_out_for_long(alone):
    idle = [connected(alone) for _ in range(300)]
    try:
        started = time.monotonic()
        eventually("an answer", lambda: alone.healthz(), within=HEAD_WITHIN_S)
        print(f"\n  an answer {time.monotonic() - started:.1f} s behind 300 idle connections")
    finally:
        for s in idle:
            s.close()


def shows(page, name):
    """Checks that the name is displayed as text and had no other effect."""
    expect(page.get_by_role("main")).to_contain_text(name)
    assert page.locator("img[src='x'], img[onerror]").count() == 0


IDS = ["markup", "quotes", "path", "right-to-left", "long"]


@pytest.mark.parametrize("name", [pytest.param(n, id=i) for n, i in zip(HOSTILE, IDS) if LONG or i == "markup"])
def test_names_that_are_code_show_as_text(plant, open_page, name):
    page = open_page(plant)
    page.get_by_label("Find").fill(name)
    # The filter is applied after a pause in typing, and moves the tiles.
    expect(page.get_by_text(re.compile(r"^1 of \d+ loops$"))).to_be_visible()
    tile = page.get_by_role("listitem").get_by_role("link").filter(has_text=name)
    expect(tile).to_have_count(1)
    shows(page, name)
    tile.click()
    expect(page).to_have_title(re.compile(re.escape(name)))
    expect(page.get_by_role("heading", level=1)).to_contain_text(name)
    page.get_by_role("button", name="Pictures", exact=True).click()
    expect(page.get_by_role("region", name="Pictures").get_by_role("img").first).to_be_visible()
    shows(page, name)
    wide = page.evaluate("() => document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0, f"{wide} px wider than the screen"
    with page.expect_download() as download:
        page.get_by_role("link", name="Window as CSV").click()
    file = download.value.suggested_filename
    assert file.endswith(".csv") and not re.search(r"[/\\<>]|^\.", file), file
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="Evidence sheet").click()
    sheet = opened.value
    sheet.wait_for_load_state()
    expect(sheet.locator("body")).to_contain_text(name)
    assert sheet.locator("img").count() == 0
    page.goto(f"http://{plant.web}/#/alarms")
    expect(page.get_by_role("heading", name="Alarms")).to_be_visible()
    expect(page.get_by_role("listitem").filter(has_text=name).first).to_be_visible()
    shows(page, name)


def test_a_stream_lives_on_and_is_never_silent_for_long(stream):
    """Last, so that the stream has been open for a while."""
    eventually("71 seconds of stream", lambda: stream["ended"] or time.monotonic() - stream["from"] > 71, within=75)
    assert stream["ended"] is None, f"ended after {stream['ended'] - stream['from']:.0f} s"
    at = [stream["from"], *stream["at"], time.monotonic()]
    assert max(b - a for a, b in zip(at, at[1:])) < SILENCE_S
    assert stream["bytes"].count(b"event: site") >= 10
