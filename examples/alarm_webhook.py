"""Turns stictiond's alarms into work order notifications: `python alarm_webhook.py PORT FILE` appends one JSON line each."""

import json
import os
import sys
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

OUT = Path(sys.argv[2])
SEEN = {json.loads(line)["id"] for line in OUT.read_text().splitlines()} if OUT.exists() else set()


class Receiver(BaseHTTPRequestHandler):
    def do_POST(self):
        alarm = json.loads(self.rfile.read(int(self.headers["content-length"])))["data"]
        # At least once: after a restart a document may come again.
        if alarm["event"] in ("raised", "worse") and alarm["event_id"] not in SEEN:
            order = {"id": alarm["event_id"], "tag": alarm["equipment"] or alarm["loop"], "priority": alarm["priority"],
                     "short": f"{alarm['loop']}: valve may stick, s {alarm['size']}", "long": f"{alarm['why']}. {alarm['what_to_do']}"}
            with OUT.open("a") as file:
                print(json.dumps(order), file=file, flush=True)
                os.fsync(file.fileno())
            SEEN.add(alarm["event_id"])
        self.send_response(204)  # only now: what is not answered 2xx comes again
        self.end_headers()


HTTPServer(("127.0.0.1", int(sys.argv[1])), Receiver).serve_forever()
