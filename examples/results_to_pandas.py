#!/usr/bin/env python3
"""Results of stictiond in pandas: from its recordings, and live over Zenoh.

    pip install pandas "mcap>=1.2,<2" zstandard "eclipse-zenoh>=1.10,<2"
    python examples/results_to_pandas.py recordings/four-loops.mcap
    python examples/results_to_pandas.py tcp/127.0.0.1:7447 demo 20

The first form reads a recording, the second listens for 20 s to a daemon below the prefix `demo` and begins with its last
answers. Both print a summary; from a program take `from_recording` or `Live`: each gives the frames `estimates` and `alarms`
(a row a document, nested fields as `oscillation.period_s`), `samples` (a row a value). Times are UTC, by the plant's clock.
"""

import json
import sys
import time

import pandas as pd

PLANE = "@stiction/v1"
SIGNALS = ("op", "pv", "sp", "mode", "mv")
COLUMNS = ["time", "loop", "verdict", "p_stiction", "s", "s_low", "s_high", "grade", "oscillation.period_s"]


class Frames:
    """Collects messages by topic and makes frames of them."""

    def __init__(self):
        self._documents = {"estimate": [], "alarm": []}
        self._samples = []

    def add(self, topic, payload):
        """Takes one message; what is neither sample, estimate nor alarm is left alone."""
        before, _, leaf = topic.rpartition("/")
        if leaf in self._documents and f"/{PLANE}/" in f"/{topic}":
            self._documents[leaf].append(json.loads(payload))
        elif leaf in SIGNALS and "/@" not in before:
            read = json.loads(payload)
            for sample in read if isinstance(read, list) else [read]:
                if isinstance(sample, dict) and "t" in sample:
                    self._samples.append((sample["t"], before, leaf, sample.get("v")))

    @property
    def estimates(self):
        """A row a window; `s_low` and `s_high` are the ends of the 90 % interval of s."""
        frame = pd.json_normalize(self._documents["estimate"])
        if frame.empty:
            return pd.DataFrame(columns=COLUMNS)
        ends = frame["s_interval"].map(lambda ends: ends if isinstance(ends, list) else [None, None])
        frame["s_low"] = pd.to_numeric(ends.str[0])
        frame["s_high"] = pd.to_numeric(ends.str[1])
        frame["time"] = pd.to_datetime(frame["window.end_ns"], utc=True)
        # A daemon that is asked for its last answer gives one that it published before.
        return frame.drop_duplicates(["loop", "window.end_ns"]).sort_values(["time", "loop"], ignore_index=True)

    @property
    def alarms(self):
        """A row a change of an alarm."""
        frame = pd.json_normalize(self._documents["alarm"])
        if frame.empty:
            return pd.DataFrame(columns=["time", "loop", "event", "state", "active", "s", "p"])
        frame["time"] = pd.to_datetime(frame["changed_ns"], utc=True)
        return frame.drop_duplicates("event_id").sort_values(["time", "loop"], ignore_index=True)

    @property
    def samples(self):
        """A row a value: `time`, `loop` (with the prefix in front), `signal`, `value`; a mode sent as a word is missing."""
        frame = pd.DataFrame(self._samples, columns=["time", "loop", "signal", "value"])
        frame["time"] = pd.to_datetime(frame["time"], utc=True)
        frame["value"] = pd.to_numeric(frame["value"], errors="coerce")
        return frame


def from_recording(path):
    """Reads a finished recording; `stictiond recover` makes one of a cut-off file."""
    from mcap.reader import make_reader

    frames = Frames()
    with open(path, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            frames.add(channel.topic, message.data)
    return frames


class Live:
    """Listens to a daemon while a `with` lasts; `frames` grows meanwhile."""

    def __init__(self, endpoint, prefix):
        self.endpoint, self.prefix, self.frames = endpoint, prefix, Frames()

    def __enter__(self):
        import zenoh

        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([self.endpoint]))
        config.insert_json5("connect/timeout_ms", "5000")
        self.session = zenoh.open(config)
        # A plain wildcard matches raw samples only: no `*` matches a chunk that begins with `@`.
        for key in (f"{self.prefix}/**", f"{self.prefix}/{PLANE}/**"):
            self.session.declare_subscriber(key, lambda s: self.frames.add(str(s.key_expr), s.payload.to_bytes()))
        for reply in self.session.get(f"{self.prefix}/{PLANE}/**"):
            if reply.ok:
                self.frames.add(str(reply.ok.key_expr), reply.ok.payload.to_bytes())
        return self

    def __exit__(self, *_):
        self.session.close()


def summary(frames):
    """Prints what there is: the newest answer of each loop, alarms, samples."""
    estimates, alarms, samples = frames.estimates, frames.alarms, frames.samples
    print(f"{len(estimates)} estimates, {len(alarms)} alarm changes, {len(samples)} samples")
    with pd.option_context("display.width", 160, "display.max_columns", 20, "display.precision", 3):
        if len(estimates):
            newest = estimates.groupby("loop").tail(1)[COLUMNS].set_index("loop").sort_index()
            print(f"\nnewest answer of each loop\n{newest}")
            print(f"\nwindows by verdict\n{estimates.groupby(['loop', 'verdict']).size().unstack(fill_value=0)}")
        if len(alarms):
            print(f"\nalarms\n{alarms[['time', 'loop', 'event', 'state', 's', 'p']]}")
        if len(samples):
            print(f"\nsamples\n{samples.groupby(['loop', 'signal'])['value'].agg(['count', 'mean', 'std', 'min', 'max'])}")


def main(arguments):
    if len(arguments) == 1:
        summary(from_recording(arguments[0]))
    elif len(arguments) == 3:
        with Live(arguments[0], arguments[1]) as live:
            time.sleep(float(arguments[2]))
        summary(live.frames)
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
