"""Reads the RINEX 3 files that `graphfix simulate` writes; no others."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from graphfix import Epoch, GpsTime, Observation, gps_time

# Columns of one value: 14 characters, loss-of-lock indicator, signal strength.
_WIDTH = 16


def epochs(path: Path) -> list[Epoch]:
    """The epochs of a file, numbered from 1."""
    lines = iter(path.read_text().splitlines())
    types = _types(lines)
    found: list[Epoch] = []
    for line in lines:
        if line.startswith(">"):
            found.append(Epoch(seq=len(found) + 1, time=_time(line)))
        else:
            found[-1].observations.extend(_observations(line, types[line[0]]))
    return found


def _types(lines: Iterator[str]) -> dict[str, list[str]]:
    types: dict[str, list[str]] = {}
    for line in lines:
        if "SYS / # / OBS TYPES" in line:
            types[line[0]] = line[6:60].split()
        elif "END OF HEADER" in line:
            break
    return types


def _time(line: str) -> GpsTime:
    year, month, day, hour, minute, second = line[1:29].split()
    whole = datetime(int(year), int(month), int(day), int(hour), int(minute))
    time = gps_time(whole)
    time.ns_of_week += round(float(second) * 1e9)
    return time


def _observations(line: str, types: list[str]) -> list[Observation]:
    found: dict[str, Observation] = {}
    for index, kind in enumerate(types):
        text = line[3 + index * _WIDTH : 3 + (index + 1) * _WIDTH]
        if not text[:14].strip():
            continue
        signal = found.setdefault(kind[1:], Observation(satellite=line[:3], code=kind[1:]))
        value = float(text[:14])
        if kind[0] == "C":
            signal.pseudorange_m = value
        elif kind[0] == "D":
            signal.doppler_hz = value
        elif kind[0] == "S":
            signal.cn0_db_hz = value
        else:
            indicator = int(text[14:15].strip() or 0)
            signal.carrier_phase_cycles = value
            signal.loss_of_lock = bool(indicator & 1)
            signal.half_cycle = bool(indicator & 2)
    return list(found.values())
