#!/usr/bin/env python3
"""A recording in Python: does the valve stick, by how much, and what does the model leave out? Cells as in a notebook.

    pip install ./python pandas matplotlib
    python examples/assess.py pictures [recordings/sticking.mcap]

Pictures go into the folder given. The command `stictiond` turns the recording into a table; it is found by STICTIOND_BIN,
in the target folder or on the path. Your own data need only two columns and a sampling time.
"""

# %% What is needed
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import stiction

ROOT = Path(__file__).resolve().parent.parent
PICTURES = Path(sys.argv[1] if len(sys.argv) > 1 else "pictures")
RECORDING = Path(sys.argv[2]) if len(sys.argv) > 2 else ROOT / "recordings" / "sticking.mcap"
OP_BLUE, PV_GREEN, WARM, GREY = "#1f5fa8", "#2e8b57", "#c4501b", "#7a7a7a"
PICTURES.mkdir(parents=True, exist_ok=True)
plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "figure.dpi": 110, "font.size": 9})


# %% Read: one table a loop, from a recording
def table_of(recording: Path) -> tuple[str, pd.DataFrame]:
    """The first loop of a recording, by its name, as rows t, op, pv, sp."""
    places = [ROOT / "target" / build / "stictiond" for build in ("release", "debug")]
    built = next((str(place) for place in places if place.exists()), None)
    command = os.environ.get("STICTIOND_BIN") or built or shutil.which("stictiond")
    if command is None:
        sys.exit("stictiond was not found: cargo build, or set STICTIOND_BIN")
    with tempfile.TemporaryDirectory() as folder:
        # A folder that is there takes every loop, a table each.
        subprocess.run([command, "convert", recording, folder], check=True)
        first = min(Path(folder).glob("**/*.csv"))
        return first.stem, pd.read_csv(first)


name, rows = table_of(RECORDING)
minutes = (rows["t"] - rows["t"].iloc[0]) / 60
print(f"{name}: {len(rows)} rows over {minutes.iloc[-1]:.0f} minutes")

# %% Assess: the verdict, its size, how sure it is
found = stiction.assess(rows["op"], rows["pv"], t=rows["t"], sp=rows.get("sp"), name=name, op_range=(0, 100))
print(found)
print(found.sureness)
for words, logits in found.reasons[:3]:
    print(f"  {logits:+.1f}  {words}")

# %% OP and PV: the end of the record, some five periods of it
shown = slice(None) if found.period_s is None else minutes > minutes.iloc[-1] - 5 * found.period_s / 60
figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(8, 4.5))
upper.plot(minutes[shown], rows["op"][shown], color=OP_BLUE, drawstyle="steps-post", lw=1.2)
upper.set_ylabel("OP, %")
upper.set_title(f"{name}: {found.words}; p {found.p_stiction:.2f}, grade {found.grade or '-'}", loc="left")
lower.plot(minutes[shown], rows["pv"][shown], color=PV_GREEN, lw=1.2, label="PV")
if "sp" in rows:
    lower.plot(minutes[shown], rows["sp"].ffill()[shown], color=GREY, lw=1, ls="--", label="SP")
lower.set_ylabel("PV and SP")
lower.set_xlabel("minutes")
lower.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.97), ncols=2)
figure.tight_layout()
figure.savefig(PICTURES / "op-pv.png")

# %% PV over OP: the cycle, and how far OP goes after a turn before the stem moves
figure, axes = plt.subplots(figsize=(4.6, 4.4))
axes.plot(rows["op"], rows["pv"], color=OP_BLUE, lw=0.5, alpha=0.5)
if found.s is not None:
    low, level = rows["op"].quantile(0.005), rows["pv"].min() - 0.08 * np.ptp(rows["pv"])
    axes.plot([low, low + found.s], [level, level], "|-", color=WARM, ms=10, mew=2, lw=2)
    axes.text(low + found.s / 2, level, f"s = {found.s:.1f} %", color=WARM, ha="center", va="bottom")
axes.set_xlabel("OP, %")
axes.set_ylabel("PV")
axes.set_title(f"{name}: the cycle", loc="left")
figure.tight_layout()
figure.savefig(PICTURES / "phase.png")

# %% The sizes with their 90 % intervals
sizes = [
    ("s, before the stem moves", found.s, found.s_interval),
    ("j, slip jump", found.j, found.j_interval),
    ("fs, static", found.fs, found.fs_interval),
    ("fd, kinetic", found.fd, found.fd_interval),
]
figure, axes = plt.subplots(figsize=(6.5, 2.4))
for at, (label, value, interval) in enumerate(reversed(sizes)):
    if value is not None and interval is not None:
        axes.plot(interval, [at, at], color=OP_BLUE, lw=5, alpha=0.35, solid_capstyle="butt")
        axes.plot(value, at, "o", color=OP_BLUE)
        axes.text(interval[1], at, f"  {value:.2f}", va="center", color=OP_BLUE)
axes.set_yticks(range(4), [label for label, *_ in reversed(sizes)])
axes.set_ylim(-0.6, 3.6)
axes.set_xlim(left=0)
axes.margins(x=0.12)
axes.set_xlabel("% of OP; bar: 90 % interval")
axes.set_title(f"{name}: how much it sticks" + (f" ({found.severity_by_range})" if found.severity_by_range else ""), loc="left")
figure.tight_layout()
figure.savefig(PICTURES / "sizes.png")

# %% The gap: a model without friction, what it leaves, and what closes it
gap = stiction.diagnose(rows["op"], rows["pv"], t=rows["t"], sp=rows.get("sp"), name=name, base="linear")
print(gap.paragraph)
run = gap.predictions
t_min = (run.t - run.t[0]) / np.timedelta64(60, "s")
end = slice(None) if found.period_s is None else t_min > t_min[-1] - 3 * found.period_s / 60
figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 5.4), height_ratios=[2, 1.2])
upper.plot(t_min[end], run.pv[end], color=PV_GREEN, lw=2.2, alpha=0.45, label="measured")
upper.plot(t_min[end], run.base[end], color=GREY, lw=1.2, label="model without friction")
upper.plot(t_min[end], run.after[end], color=WARM, lw=1, ls="--", label=f"with {gap.cause}")
upper.set_ylabel("PV")
upper.set_xlabel("minutes")
upper.set_title(f"{name}: {gap.cause}, p {gap.probability:.2f}", loc="left", pad=20)
upper.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.97), ncols=3)
best = list(reversed(gap.effects[:6]))
lower.barh([e.id for e in best], [max(e.closed_pct or 0, 0) for e in best], color=OP_BLUE, height=0.6)
lower.set_xlim(0, 100)
lower.set_xlabel("% of the gap that an effect closes, on data it was not fitted to")
figure.tight_layout()
figure.savefig(PICTURES / "gap.png")
print(f"pictures in {PICTURES}")
