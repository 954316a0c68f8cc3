#!/usr/bin/env python3
"""From a historian's export to pictures, in cells as in a notebook; the first cell is all that a picture needs.

    pip install './python[plot,pandas,sklearn]'
    python examples/notebook.py pictures

Pictures go into the folder given. In a notebook leave out `savefig`: the value of a cell is shown.
"""

# %% Where the export is and pictures go
import sys
from pathlib import Path

EXPORT = Path(__file__).resolve().parent.parent / "recordings" / "fic201-export.csv"
PICTURES = Path(sys.argv[1] if len(sys.argv) > 1 else "pictures")
PICTURES.mkdir(parents=True, exist_ok=True)

# %% An export with German numbers and dates: from the file to a picture in four lines
import stiction

frame = stiction.read(EXPORT, tz="Europe/Berlin")
found = stiction.assess(frame, op_range=(0, 100))
found.plot().savefig(PICTURES / "assessment.png")

# %% In words, and as a row of a table
print(found)
print(found.to_frame().T)

# %% What the model without friction leaves in the first ten minutes, and what explains it
gap = stiction.diagnose(frame.iloc[:600], base="linear")
gap.plot().savefig(PICTURES / "gap.png")
print(gap.to_frame().head())

# %% Every window of the record: does the size change?
windows = stiction.assess_windows(frame, hop_s=300)
together = stiction.over_time(windows)
together.plot().savefig(PICTURES / "history.png")
print(together.to_frame().tail())

# %% What a repair would bring
benefit = stiction.repair(frame, op_range=(0, 100))
benefit.plot().figure.savefig(PICTURES / "repair.png")
print(" ".join(benefit["sentences"]))

# %% Many loops: with the conventions of scikit-learn, a table per loop
loops = [frame, frame.iloc[:900]]
detector = stiction.StictionDetector(ts_s=None, op_range=(0, 100)).fit(loops)
print(detector.predict(loops), detector.predict_proba(loops).round(2))
results = detector.assess(loops)
results.plot().figure.savefig(PICTURES / "loops.png")
print(results.to_frame()[["loop", "verdict", "p_stiction", "s", "s_low", "s_high"]])
