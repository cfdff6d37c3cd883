"""Compares positions in the ETRS89, and heights above the geoid, with PROJ's.

Usage: frames.py NATIVE ETRS89 FRAME YEAR TABLE
NATIVE and ETRS89 are CSV files of the same recording without and with the option. FRAME and YEAR are
those of the native positions; an empty YEAR: the time of each epoch. TABLE is the GTX table of the
heights above the geoid. Prints the number of positions and the largest differences (m).
"""

import csv
import datetime
import json
import math
import sys

import pyproj

native, etrs89, frame, year, table = sys.argv[1:]
GPS_EPOCH = datetime.datetime(1980, 1, 6)
CRS = {"ITRF2020": 9988, "ITRF2014": 7789, "ITRF2008": 5332, "ITRF2005": 4896, "ITRF2000": 4919}
ETRF2000 = 7930


def rows(path):
    with open(path, encoding="utf-8") as file:
        return list(csv.DictReader(file))


def decimal_year(row):
    seconds = int(row["gps_week"]) * 604800 + float(row["tow_s"])
    time = GPS_EPOCH + datetime.timedelta(seconds=seconds)
    start, end = (datetime.datetime(y, 1, 1) for y in (time.year, time.year + 1))
    return time.year + (time - start) / (end - start)


def ecef(row):
    return [float(row[axis]) for axis in ("x_m", "y_m", "z_m")]


# The pipeline of EPSG, without what PROJ would choose by itself.
group = pyproj.transformer.TransformerGroup(CRS[frame], ETRF2000, always_xy=True)
to_etrs89 = group.transformers[0]
assert "ETRF2000" in to_etrs89.description, to_etrs89.description
to_height = pyproj.Transformer.from_pipeline(
    f"+proj=pipeline +step +inv +proj=vgridshift +grids={table} +multiplier=1"
)
moved = geoid = 0.0
pairs = list(zip(rows(native), rows(etrs89), strict=True))
answered = [(a, b) for a, b in pairs if a["x_m"]]
for here, there in answered:
    assert there["frame"] == "ETRF2000", there
    epoch = float(year) if year else decimal_year(here)
    expected = to_etrs89.transform(*ecef(here), epoch)[:3]
    moved = max(moved, math.dist(expected, ecef(there)))
    height = float(there["height_m"])
    place = [math.radians(float(there[key])) for key in ("longitude_deg", "latitude_deg")]
    _, _, above = to_height.transform(*place, height, radians=True)
    geoid = max(geoid, abs(above - float(there["orthometric_height_m"])))
print(json.dumps({"positions": len(answered), "moved": moved, "geoid": geoid}))
