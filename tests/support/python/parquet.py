"""Reads a track in Parquet with pyarrow and DuckDB, and compares each value with the CSV.

Usage: parquet.py FOLDER NAME
The folder has NAME.csv and NAME.parquet. Prints the numbers of epochs, positions and columns.
"""

import csv
import datetime
import json
import math
import pathlib
import sys

import duckdb
import pyarrow.parquet

folder, name = sys.argv[1:]
stem = pathlib.Path(folder) / name
GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.timezone.utc)
LEAP_SECONDS = 18

with open(f"{stem}.csv", encoding="ascii") as file:
    rows = list(csv.DictReader(file))
table = pyarrow.parquet.read_table(f"{stem}.parquet")
assert table.column_names == ["time_utc", *rows[0]], table.column_names
assert str(table.schema.field("time_utc").type) == "timestamp[us, tz=UTC]"
for row, read in zip(rows, table.to_pylist(), strict=True):
    seconds = int(row["gps_week"]) * 604800 + float(row["tow_s"]) - LEAP_SECONDS
    assert read["time_utc"] == GPS_EPOCH + datetime.timedelta(seconds=round(seconds, 3))
    for column, text in row.items():
        value = read[column]
        if text == "":
            # A column of numbers has no value that is not finite.
            assert value is None, (column, value)
        elif isinstance(value, (int, float)):
            decimals = len(text.partition(".")[2])
            tolerance = 0.51 * 10.0**-decimals
            assert math.isclose(value, float(text), rel_tol=1e-12, abs_tol=tolerance), (column, value, text)
        else:
            assert value == text, (column, value, text)
answered = [row for row in rows if row["status"] != "NONE"]
query = f"""SELECT status, COUNT(*), COUNT(x_m), MAX(time_utc) - MIN(time_utc), AVG(height_m)
            FROM '{stem}.parquet' WHERE status <> 'NONE' GROUP BY status"""
by_status = {status: (count, positions) for status, count, positions, _, _ in duckdb.sql(query).fetchall()}
for status in {row["status"] for row in answered}:
    count = sum(row["status"] == status for row in answered)
    assert by_status[status] == (count, count), by_status
print(json.dumps({"epochs": len(rows), "positions": len(answered), "columns": len(table.column_names)}))
