"""Reads a track in every format with programs that others wrote, and compares each with its CSV.

Usage: tracks.py FOLDER NAME
The folder has NAME.csv, NAME.nmea, NAME.gpx, NAME.kml and NAME.geojson. Prints the number of epochs and
of positions.
"""

import csv
import datetime
import json
import math
import pathlib
import sys
from xml.etree import ElementTree

import fastkml
import fastkml.validator
import gpxpy
import pynmea2

folder, name = sys.argv[1:]
stem = pathlib.Path(folder) / name
GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.timezone.utc)
LEAP_SECONDS = 18
QUALITY = {"NONE": 0, "SINGLE": 1, "EKF": 1, "FGO": 1, "FLOAT": 5, "FIXED": 4}

with open(f"{stem}.csv", encoding="ascii") as file:
    rows = list(csv.DictReader(file))
answered = [row for row in rows if row["status"] != "NONE"]


def utc(row):
    seconds = int(row["gps_week"]) * 604800 + float(row["tow_s"]) - LEAP_SECONDS
    return GPS_EPOCH + datetime.timedelta(seconds=round(seconds, 3))


def place(row):
    return tuple(float(row[key]) for key in ("latitude_deg", "longitude_deg", "height_m"))


def near(seen, expected, tolerance, what):
    for value, wanted in zip(seen, expected, strict=True):
        assert math.isclose(value, wanted, rel_tol=0, abs_tol=tolerance), (what, seen, expected)


# pynmea2 checks the checksum of each sentence.
with open(f"{stem}.nmea", encoding="ascii", newline="") as file:
    text = file.read()
assert text.endswith("\r\n")
sentences = [pynmea2.parse(line, check=True) for line in text.split("\r\n")[:-1]]
assert len(sentences) == 4 * len(rows), len(sentences)
for index, row in enumerate(rows):
    gga, rmc, vtg, gst = sentences[4 * index : 4 * index + 4]
    kinds = [sentence.sentence_type for sentence in (gga, rmc, vtg, gst)]
    assert kinds == ["GGA", "RMC", "VTG", "GST"], kinds
    assert rmc.datetime.replace(tzinfo=datetime.timezone.utc) == utc(row), (rmc.datetime, utc(row))
    assert gga.timestamp == gst.timestamp == rmc.timestamp
    assert gga.gps_qual == QUALITY[row["status"]], (gga, row["status"])
    assert rmc.is_valid == (row["status"] != "NONE")
    assert gga.geo_sep in (None, ""), gga
    if row["status"] == "NONE":
        continue
    latitude, longitude, height = place(row)
    near((gga.latitude, gga.longitude), (latitude, longitude), 2e-9, "GGA")
    near((rmc.latitude, rmc.longitude), (latitude, longitude), 2e-9, "RMC")
    near((float(gga.altitude),), (height,), 6e-4, "altitude")
    assert int(gga.num_sats) == int(row["satellites"])
    near((float(gga.horizontal_dil),), (float(row["hdop"]),), 0.051, "hdop")
    deviations = (float(gst.std_dev_latitude), float(gst.std_dev_longitude), float(gst.std_dev_altitude))
    variances = (row["var_n_m2"], row["var_e_m2"], row["var_u_m2"])
    near(deviations, [math.sqrt(float(v)) for v in variances], 2e-4, "GST")
    major, minor = float(gst.std_dev_major), float(gst.std_dev_minor)
    trace = float(row["var_e_m2"]) + float(row["var_n_m2"])
    near((major**2 + minor**2,), (trace,), 1e-3 * max(1.0, trace), "axes")
    if row["ve_m_s"]:
        east, north = float(row["ve_m_s"]), float(row["vn_m_s"])
        speed = math.hypot(east, north)
        near((float(vtg.spd_over_grnd_kmph) / 3.6,), (speed,), 2e-3, "VTG")
        near((float(rmc.spd_over_grnd) * 1852 / 3600,), (speed,), 2e-3, "RMC speed")
        if 0.5 < speed:
            course = math.degrees(math.atan2(east, north)) % 360
            near((float(vtg.true_track),), (course,), 0.2, "course")

with open(f"{stem}.gpx", encoding="utf-8") as file:
    gpx = gpxpy.parse(file)
points = [point for track in gpx.tracks for segment in track.segments for point in segment.points]
assert len(points) == len(answered), len(points)
for point, row in zip(points, answered):
    near((point.latitude, point.longitude), place(row)[:2], 1e-9, "GPX")
    near((point.elevation,), place(row)[2:], 1e-4, "GPX elevation")
    assert abs(point.time - utc(row)) < datetime.timedelta(milliseconds=1)
    assert (point.type, point.satellites) == (row["status"], int(row["satellites"]))

assert fastkml.validator.validate(file_to_validate=pathlib.Path(f"{stem}.kml")), "not of the KML schema"
kml = fastkml.KML.parse(pathlib.Path(f"{stem}.kml"))
placemarks = list(kml.features[0].features)
points = [placemark for placemark in placemarks if placemark.geometry.geom_type == "Point"]
lines = [placemark for placemark in placemarks if placemark.geometry.geom_type == "LineString"]
assert len(points) == len(answered), len(points)
for point, row in zip(points, answered):
    latitude, longitude, height = place(row)
    near(point.geometry.coords[0], (longitude, latitude, height), 1e-4, "KML")
    assert point.name == row["status"] and point.style_url.url == f"#{row['status']}"
    assert point.times.timestamp.dt == utc(row)
styles = {style.id for style in kml.features[0].styles}
assert {line.style_url.url[1:] for line in lines} <= styles, styles
ElementTree.parse(f"{stem}.kml")

with open(f"{stem}.geojson", encoding="utf-8") as file:
    features = json.load(file)["features"]
points = [feature for feature in features if feature["geometry"]["type"] == "Point"]
for point, row in zip(points, answered, strict=True):
    latitude, longitude, height = place(row)
    near(point["geometry"]["coordinates"], (longitude, latitude, height), 1e-9, "GeoJSON")

print(json.dumps({"epochs": len(rows), "positions": len(answered), "lines": len(lines)}))
