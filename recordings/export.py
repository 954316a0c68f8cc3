"""Makes an export of a loop as a German historian would write it, from a table of `stictiond convert`.

    stictiond convert recordings/four-loops.mcap fic201.csv --loop FIC201
    python3 recordings/export.py 41FIC201 < fic201.csv > recordings/fic201-export.csv
    stictiond convert recordings/physical.mcap fic501.csv --loop FIC501
    python3 recordings/export.py 41FIC501 < fic501.csv > recordings/fic501-export.csv

Semicolons, decimal commas, local time without a zone, tags with units in brackets.
"""

import csv
import datetime
import sys
import zoneinfo

ZONE = zoneinfo.ZoneInfo("Europe/Berlin")
TAG = sys.argv[1]
NAMES = {"op": f"{TAG}.OP [%]", "pv": f"{TAG}.PV [m3/h]", "sp": f"{TAG}.SP [m3/h]"}

print("Zeit", *NAMES.values(), sep=";")
for row in csv.DictReader(sys.stdin):
    time = datetime.datetime.fromtimestamp(float(row["t"]), ZONE)
    print(f"{time:%d.%m.%Y %H:%M:%S}", *(row[name].replace(".", ",") for name in NAMES), sep=";")
