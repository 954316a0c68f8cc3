"""Makes fic201-export.csv: loop FIC201 of four-loops.mcap as a German historian would export it.

    stictiond convert recordings/four-loops.mcap fic201.csv --loop FIC201
    python3 recordings/export.py < fic201.csv > recordings/fic201-export.csv

Semicolons, decimal commas, local time without a zone, tags with units in brackets.
"""

import csv
import datetime
import sys
import zoneinfo

ZONE = zoneinfo.ZoneInfo("Europe/Berlin")
NAMES = {"op": "41FIC201.OP [%]", "pv": "41FIC201.PV [m3/h]", "sp": "41FIC201.SP [m3/h]"}

print("Zeit", *NAMES.values(), sep=";")
for row in csv.DictReader(sys.stdin):
    time = datetime.datetime.fromtimestamp(float(row["t"]), ZONE)
    print(f"{time:%d.%m.%Y %H:%M:%S}", *(row[name].replace(".", ",") for name in NAMES), sep=";")
