"""The life of an alarm as users see it, with a killed daemon and a lost network in between."""

import json
import re
import time
from datetime import datetime, timezone

import pytest
from conftest import AWAY, api, bus_at, loop_path, zenoh_at
from mcap.reader import make_reader
from playwright.sync_api import expect

from daemon import Daemon, eventually, free_port, stictiond

LOOP = "FIC900"
PART_S = 1200
HOP_S = 150
STALE_WITHIN_MS = 20_000

SCENARIO = """
[site]
prefix = "repair"
[run]
start = "{start}"
duration_s = {seconds}.0
ts_s = 1.0
seed = 4
warmup_s = 900.0
[[loop]]
name = "{name}"
label = "{label}"
operating_point = {{ op = 50.0, pv = 60.0 }}
setpoint = 61.0
process = {{ gain = 2.0, time_constants_s = [20.0], dead_time_s = 6.0 }}
controller = {{ kc = 0.8, ti_s = 8.0, op_resolution = 0.01 }}
{valve}
noise = {{ pv_sd = 0.05 }}
recording = {{ signals = ["op", "pv", "sp"], pv_quantum = 0.01 }}
"""


class Repair:
    """A daemon, and a plant with a valve that sticks in the first part and is repaired in the second."""

    def __init__(self, folder):
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        # Windows end at multiples of the hop, so they are the same in every run.
        self.start = time.time() // HOP_S * HOP_S - 2 * PART_S
        self.parts = []
        for k, (label, valve) in enumerate(
            [("stiction", 'valve = { law = "he", fs = 5.0, fd = 2.0 }'), ("no_stiction", "")]
        ):
            start = datetime.fromtimestamp(self.start + k * PART_S, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
            toml, out = folder / f"{label}.toml", folder / f"{label}.mcap"
            toml.write_text(SCENARIO.format(start=start, seconds=PART_S, name=LOOP, label=label, valve=valve))
            code, _, said = stictiond("simulate", toml, "--raw", "--out", out)
            assert code == 0, said
            self.parts.append(out)
        more = f'[window]\nhop_s = {HOP_S}\nmax_window_s = 600\n[alarm]\nraise = [2, 3]\n[[loop]]\nname = "{LOOP}"\narea = "Unit 9"\nop_range = [0, 100]\n'
        self.daemon = Daemon(folder, "repair", zenoh_at(self.endpoint), more)

    def play(self, part):
        code, out, said = stictiond("play", self.parts[part], "--connect", self.endpoint, "--prefix", "repair", "--speed", "300")
        assert code == 0, said


@pytest.fixture(scope="module")
def repair(tmp_path_factory):
    made = Repair(tmp_path_factory.mktemp("repair"))
    with made.daemon:
        yield made


def alarm(repair):
    return api(repair.daemon, loop_path(LOOP))["alarm"]


def entry(page):
    return page.get_by_role("listitem").filter(has=page.get_by_role("heading", name=re.compile(LOOP)))


def answer(page, button, **fields):
    """Presses a button of the alarm and fills in its dialog."""
    page.get_by_role("button", name=f"{button}: {LOOP}", exact=True).first.click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_label("Your name")).to_be_focused()
    for label, value in fields.items():
        dialog.get_by_label(label).fill(value)
    dialog.get_by_role("button", name=button).click()
    expect(dialog).to_have_count(0)


def test_an_alarm_rises_is_acknowledged_shelved_and_taken_back(repair, open_page):
    page = open_page(repair.daemon, "#/alarms")
    bus = bus_at(repair.endpoint, "repair")
    said = []
    watching = bus.declare_subscriber(
        f"repair/@stiction/v1/{LOOP}/alarm", lambda s: said.append(json.loads(s.payload.to_string()))
    )
    expect(page.get_by_text("No alarm")).to_be_visible()
    repair.play(0)
    expect(entry(page)).to_contain_text("active, unacknowledged", timeout=60_000)
    expect(page.get_by_role("navigation", name="Main")).to_contain_text("1 unacknowledged")
    # Acknowledging needs a name; Esc changes nothing.
    page.get_by_role("button", name=f"Acknowledge: {LOOP}", exact=True).click()
    page.get_by_role("dialog").get_by_role("button", name="Acknowledge").click()
    expect(page.get_by_role("dialog").get_by_label("Your name")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert alarm(repair)["state"] == "unack"

    answer(page, "Acknowledge", **{"Your name": "Ann", "Reason": "packing, stop in May"})
    expect(entry(page)).to_contain_text("active, acknowledged")
    expect(entry(page)).to_contain_text("acknowledged by Ann")
    expect(entry(page)).to_contain_text("packing, stop in May")
    answer(page, "Shelve", **{"Reason": "unit is down"})
    expect(entry(page)).to_have_count(0)
    shelf = page.get_by_role("group", name="Filter by state").get_by_role("button", name=re.compile("^shelved"))
    expect(shelf).to_contain_text("1")
    shelf.click()
    expect(entry(page)).to_contain_text("shelved by Ann")
    answer(page, "Unshelve")
    page.get_by_role("group", name="Filter by state").get_by_role("button", name=re.compile("^open")).click()
    expect(entry(page)).to_contain_text("active, acknowledged")

    page.goto(f"http://{repair.daemon.web}/#/loop/{LOOP}")
    expect(page.get_by_role("main")).to_contain_text("alarm active, acknowledged")
    # The bus has the same changes, and the newest on the page is the bus's.
    eventually("four changes on the bus", lambda: len(said) >= 4)
    assert [d["event"] for d in said] == ["raised", "acknowledged", "shelved", "unshelved"], said
    assert alarm(repair) == said[-1]
    assert said[1]["acknowledged"]["by"] == "Ann" and said[1]["acknowledged"]["why"] == "packing, stop in May"
    watching.undeclare()
    bus.close()


def strip(page):
    return page.get_by_label("Connection and data health")


def is_live(page):
    expect(strip(page)).to_contain_text("Live", timeout=40_000)
    expect(strip(page)).not_to_contain_text("Stale")


def test_a_page_outlives_reload_kill_and_a_lost_network(repair, open_page):
    page = open_page(repair.daemon, "", lossy=AWAY)
    alarms = open_page(repair.daemon, "#/alarms", lossy=AWAY)
    tile = page.get_by_role("link", name=re.compile(f"^{LOOP}, maintenance required")).first
    is_live(page)
    expect(tile).to_be_visible()
    page.reload()
    is_live(page)
    expect(tile).to_be_visible()

    repair.daemon.process.kill()
    repair.daemon.process.wait()
    expect(strip(page)).to_contain_text("Stale", timeout=STALE_WITHIN_MS)
    expect(strip(alarms)).to_contain_text("Stale", timeout=STALE_WITHIN_MS)
    expect(tile).to_be_visible()
    repair.daemon.__enter__()
    for shown in (page, alarms):
        is_live(shown)
    # The alarm and Ann's comment are unchanged.
    expect(entry(alarms)).to_contain_text("active, acknowledged", timeout=15_000)
    expect(entry(alarms)).to_contain_text("packing, stop in May")
    expect(page.get_by_role("link", name=re.compile(f"^{LOOP}, ")).first).to_be_visible()

    page.context.set_offline(True)
    expect(strip(page)).to_contain_text("Stale", timeout=STALE_WITHIN_MS)
    page.context.set_offline(False)
    is_live(page)


def test_the_alarm_clears_when_the_valve_moves_freely(repair, open_page):
    # After the restart there is no sample to draw yet, and the browser logs the resulting 404.
    page = open_page(repair.daemon, f"#/loop/{LOOP}", lossy=r"404 .*/window\)")
    alarms = open_page(repair.daemon, "#/alarms")
    expect(page.get_by_role("main")).to_contain_text("alarm active, acknowledged")
    repair.play(1)
    expect(entry(alarms)).to_have_count(0, timeout=60_000)
    normal = alarms.get_by_role("group", name="Filter by state").get_by_role("button", name=re.compile("^back to normal"))
    expect(normal).to_contain_text("1")
    expect(page.get_by_role("heading", level=1)).not_to_contain_text("sticks")
    expect(page.get_by_role("main")).to_contain_text("no alarm")
    page.get_by_role("button", name="Alarm history").click()
    history = page.get_by_role("region", name="Changes of the alarm").get_by_role("row")
    expect(history.filter(has_text="cleared")).to_have_count(1)
    expect(history.filter(has_text="packing, stop in May")).not_to_have_count(0)
    # The button shows the history even if the section never comes near the screen.
    page.add_init_script("window.IntersectionObserver = class { observe() {} disconnect() {} }")
    page.reload()
    page.get_by_role("button", name="Alarm history").click()
    expect(history.filter(has_text="cleared")).to_have_count(1)

    assert alarm(repair)["state"] == "normal" and not alarm(repair)["active"]
    # The recording has the same.
    repair.daemon.stop()
    for cut in repair.daemon.recordings.glob("*.part"):
        assert stictiond("recover", cut, "--out", cut.with_suffix(""))[0] in (0, 3)
    recorded = []
    for path in repair.daemon.recordings.glob("*.mcap"):
        with path.open("rb") as file:
            messages = make_reader(file).iter_messages(topics=[f"repair/@stiction/v1/{LOOP}/alarm"])
            recorded += [(message.log_time, json.loads(message.data)["event"]) for _, _, message in messages]
    events = [event for _, event in sorted(recorded) if event != "restored"]
    assert events == ["raised", "acknowledged", "shelved", "unshelved", "cleared"], events
