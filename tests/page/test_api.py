"""The page's API: its OpenAPI description is valid, and its answers match it."""

import json
import time
import urllib.error
import urllib.request

import jsonschema
import pytest
from conftest import NS, TOKEN, api, bus_at, put, zenoh_at
from openapi_spec_validator import OpenAPIV31SpecValidator

from daemon import Daemon, eventually, free_port
from plant import Loop

LOOP = "FIC101"


@pytest.fixture(scope="module")
def description(plant):
    return api(plant, "/openapi.json")


def ask(daemon, path):
    """Status, kind and body."""
    try:
        with urllib.request.urlopen(f"http://{daemon.web}{path}", timeout=60) as answer:
            return answer.status, answer.headers["content-type"], answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["content-type"], error.read()


def fits(schema, description, document, where):
    """Checks a document with a schema; every reference points into the description."""
    assert schema is not False, where
    whole = {**(schema if schema is not True else {}), "components": description["components"]}
    faults = [f"{where}: {list(e.absolute_path)}: {e.message[:200]}" for e in jsonschema.Draft202012Validator(whole).iter_errors(document)]
    assert not faults, "\n".join(faults[:10])


def test_the_description_is_valid_openapi(description):
    assert description["openapi"].startswith("3.1")
    OpenAPIV31SpecValidator(description).validate()


def test_every_answer_fits_its_description(plant, description):
    seen = 0
    for path, methods in description["paths"].items():
        get = methods.get("get")
        if get is None:
            continue
        content = get["responses"]["200"]["content"]
        if "text/event-stream" in content:
            continue
        status, kind, body = ask(plant, path.replace("{name}", LOOP).replace("{id}", "1"))
        if status != 200:
            assert status in (404, 422), (path, status, body[:300])
            assert set(json.loads(body)) == {"error"}, (path, body[:300])
            continue
        seen += 1
        assert kind.split(";")[0] in {c.split(";")[0] for c in content}, (path, kind, list(content))
        assert body, path
        if "application/json" in content:
            fits(content["application/json"]["schema"], description, json.loads(body), path)
    assert seen >= 14, f"only {seen} operations answered"


def test_what_is_not_there_and_what_does_not_fit_is_refused_in_words(plant):
    cases = {
        "/api/v1/nothing": 404,
        "/api/v1/loops/none/window": 404,
        "/api/v1/loops/none": 404,
        f"/api/v1/loops/{LOOP}/trend?from_ms=abc": 400,
        f"/api/v1/loops/{LOOP}/trend?from=2026-01-05": 400,
        f"/api/v1/loops/{LOOP}/trend?from_ms=2&to_ms=1": 422,
        f"/api/v1/loops/{LOOP}/trend?points=-1": 400,
        f"/api/v1/loops/{LOOP}/trend?from_ms=-1e300&to_ms=1e300&points=99999999": 200,
        f"/api/v1/loops/{LOOP}/trend?from_ms=NaN": 422,
        "/api/v1/loops/%FF": 400,
        "/nothing.html": 404,
    }
    for path, wanted in cases.items():
        status, _, body = ask(plant, path)
        assert status == wanted, (path, status, body[:200])
        if wanted != 200 and path.startswith("/api/"):
            assert body.startswith(b'{"error":'), (path, status, body[:200])


def test_wrong_commands_are_refused_and_change_nothing(plant):
    before = api(plant, f"/loops/{LOOP}")["alarm"]
    address = f"/api/v1/loops/{LOOP}/alarm"
    cases = [
        ({"cmd": "ack"}, 422), ({"cmd": "explode", "by": "Ann"}, 422), ({"cmd": "ack", "by": ""}, 422),
        ({"cmd": "ack", "by": "x" * 65}, 422), ({"cmd": "ack", "by": "Ann", "why": "y" * 501}, 422),
        ({"cmd": "ack", "by": "a\nb"}, 422), ({"cmd": "shelve", "by": "Ann", "for_s": 0}, 422),
        ({"cmd": "shelve", "by": "Ann", "for_s": -1}, 422), ({"cmd": "shelve", "by": "Ann", "for_s": 10**9}, 422),
        ({"cmd": "ack", "by": "Ann", "extra": 1}, 422), ([], 422), ("not json", 400), (None, 400),
    ]
    for body, wanted in cases:
        data = body.encode() if isinstance(body, str) else json.dumps(body).encode() if body is not None else b""
        request = urllib.request.Request(
            f"http://{plant.web}{address}", data, method="POST",
            headers={"Content-Type": "application/json", "X-Stictiond": "1", "Authorization": f"Bearer {TOKEN}"},
        )
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(request, timeout=20)
        said = refused.value.read()
        assert refused.value.code == wanted, (body, refused.value.code, said)
        assert set(json.loads(said)) == {"error"}, (body, said)
    assert api(plant, f"/loops/{LOOP}")["alarm"] == before


def test_an_estimate_keeps_its_evidence_over_a_data_gap(tmp_path):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    start_s = int(time.time()) // 600 * 600 - 7200
    loop = Loop(fs=5.0, fd=3.0, seed=1).run(1800)
    with Daemon(tmp_path, "p", zenoh_at(endpoint), "[window]\nhop_s = 600\n") as daemon:
        bus = bus_at(endpoint, "p")

        def publish(a, b, later_s):
            for signal, values in (("op", loop.op), ("pv", loop.pv)):
                put(bus, f"p/A/{signal}", [{"t": (start_s + later_s + k) * NS, "v": values[k]} for k in range(a, b)])

        def window():
            loops = {row["name"]: row for row in api(daemon, "/loops")["loops"]}
            return loops.get("A", {}).get("window_end_ms")

        publish(0, 1220, 0)
        eventually("an estimate", lambda: window() == (start_s + 1200) * 1000, within=90)
        before = ask(daemon, "/api/v1/loops/A/pictures")
        # An hour is missing, so the loop's history starts again after it.
        publish(1220, 1400, 3600)
        eventually("the gap", lambda: api(daemon, "/loops/A/window")["t_ms"][0] > (start_s + 1300) * 1000)
        after = ask(daemon, "/api/v1/loops/A/pictures")
        bus.close()
    assert before[0] == after[0] == 200, after
    pictures = [json.loads(body)["pictures"] for _, _, body in (before, after)]
    assert [one["title"] for one in pictures[0]] == [one["title"] for one in pictures[1]] and len(pictures[1]) > 5
