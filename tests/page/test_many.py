"""Five thousand loops: the overview shows them all and stays usable."""

import json
import re
import socket
import time
from pathlib import Path

import pytest
from conftest import NS, api, bus_at, put, zenoh_at
from playwright.sync_api import expect

from daemon import Daemon, eventually, free_port

LOOPS = 5000
COUNT = "document.querySelectorAll('main li a[href^=\"#/loop/\"]').length"
ALL = f"() => {COUNT} === {LOOPS}"


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with Daemon(tmp_path_factory.mktemp("many"), "many", zenoh_at(endpoint)) as daemon:
        daemon.bus = bus_at(endpoint, "many")
        publish(daemon.bus, 0)
        eventually("all tiles", lambda: len(api(daemon, "/loops")["loops"]) == LOOPS, within=90)
        yield daemon
        daemon.bus.close()


def publish(bus, turn):
    """Three samples of every loop."""
    start = int(time.time()) - 10 + 3 * turn
    for k in range(LOOPS):
        for signal, value in (("op", 50.0), ("pv", 60.0)):
            samples = [{"t": (start + i) * NS, "v": value + (k + i) % 7} for i in range(3)]
            put(bus, f"many/U{k // 50:02}-FIC{k:04}/{signal}", samples)


def test_all_tiles_show_and_a_filter_is_quick(many, open_page):
    started = time.monotonic()
    page = open_page(many)
    page.wait_for_function(ALL, timeout=60_000)
    print(f"\n  {LOOPS} tiles after {time.monotonic() - started:.1f} s")
    expect(page.get_by_text(f"{LOOPS:,} loops", exact=True)).to_be_visible()
    page.evaluate("""() => {
      const find = document.querySelector('input[type=search]');
      find.addEventListener('keydown', () => {
        const from = performance.now();
        requestAnimationFrame(() => requestAnimationFrame(() => (window.took = performance.now() - from)));
      });
    }""")
    find = page.get_by_label("Find")
    took = []
    for key in "FIC4711":
        page.evaluate("() => { window.took = null; }")
        find.press(key)
        took.append(page.wait_for_function("() => window.took").json_value())
    print(f"  a key of the filter: {max(took):.0f} ms at most")
    expect(page.get_by_text(f"1 of {LOOPS:,} loops", exact=True)).to_be_visible()
    expect(page.get_by_role("link", name=re.compile("^U94-FIC4711"))).to_be_visible()
    page.get_by_role("button", name="Clear filters").click()
    page.wait_for_function(ALL)


def test_a_tile_clicked_while_the_last_letter_of_a_search_waits_leads_to_its_loop(many, open_page):
    page = open_page(many)
    page.wait_for_function(ALL, timeout=60_000)
    page.evaluate("""() => {
      const find = document.querySelector('input[type=search]');
      find.value = 'FIC4711';
      find.dispatchEvent(new Event('input', { bubbles: true }));
      document.querySelector("main li a[href^='#/loop/']").click();
    }""")
    # Longer than the pause before a search is written to the address.
    page.wait_for_timeout(500)
    assert page.evaluate("location.hash").startswith("#/loop/")
    # A loop without a window has no pictures, and the browser would log an error if it requested them.
    pictures = page.get_by_role("region", name="Pictures")
    pictures.scroll_into_view_if_needed()
    expect(pictures).to_contain_text("No window yet")


def test_scrolling_reaches_and_draws_the_last_tile(many, open_page):
    page = open_page(many)
    page.wait_for_function(ALL, timeout=60_000)
    last = page.locator("main li a[href^='#/loop/']").last
    page.mouse.move(700, 600)
    page.mouse.wheel(0, 3000)
    page.wait_for_function("() => scrollY > 1000")
    page.evaluate("() => scrollTo(0, document.documentElement.scrollHeight)")
    expect(last).to_be_in_viewport()
    expect(last).to_contain_text(re.compile("U99-FIC4999.*(no window yet|waiting for a window)"))


def resident_mb(daemon, seconds):
    """Peak memory of the daemon within some seconds, MB."""
    most, until = 0, time.monotonic() + seconds
    while time.monotonic() < until:
        status = Path(f"/proc/{daemon.process.pid}/status").read_text()
        most = max(most, int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024)
        time.sleep(0.1)
    return most


def test_streams_that_nobody_reads_do_not_fill_memory(many):
    host, port = many.web.split(":")
    sockets = []
    for _ in range(20):
        s = socket.socket()
        s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        s.connect((host, int(port)))
        s.sendall(f"GET /api/v1/events HTTP/1.1\r\nHost: {many.web}\r\n\r\n".encode())
        sockets.append(s)
    # Every stream begins with all rows; later events must not pile up behind them.
    publish(many.bus, 1)
    before = resident_mb(many, 5)
    for turn in range(2, 8):
        publish(many.bus, turn)
    after = resident_mb(many, 5)
    for s in sockets:
        s.close()
    print(f"\n  {before:.0f} MB resident with 20 unread streams, {after:.0f} MB after six more rounds of {LOOPS} loops")
    # If they piled up, six rounds of all rows for twenty streams would take 600 MB; the first round may still be in transit.
    assert after - before < 150
