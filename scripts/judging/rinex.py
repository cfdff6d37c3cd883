"""RINEX 3 observations, read and written field by field.

What a fault does not touch is written as it was read. Event records are left out.
"""

import gzip
from dataclasses import dataclass, field
from datetime import datetime

GPS_EPOCH = datetime(1980, 1, 6)
SPEED_OF_LIGHT = 299_792_458.0
FIELD_WIDTH = 16
VALUE_WIDTH = 14
SYSTEM_COLUMN = 0
LABEL_COLUMN = 60
# Carrier frequencies by constellation and band (Hz): RINEX 3.05, tables 9 to 15.
DEFAULT_HZ = {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6, "6": 1278.75e6, "7": 1207.14e6, "8": 1191.795e6}
BEIDOU_HZ = {"2": 1561.098e6, "6": 1268.52e6}
# GLONASS: frequency of channel 0 and from channel to channel (Hz).
GLONASS_HZ = {"1": (1602.0e6, 562.5e3), "2": (1246.0e6, 437.5e3)}
LOST_LOCK = 1
HALF_CYCLE = 2


class UnsupportedFile(Exception):
    """This reader cannot read the file."""


@dataclass(frozen=True)
class Value:
    """One observation: value, loss-of-lock indicator and signal strength as they stand there."""

    number: float
    lock: str = " "
    strength: str = " "

    def plus(self, amount):
        return Value(self.number + amount, self.lock, self.strength)

    def with_lock(self, bits):
        before = int(self.lock) if self.lock.strip() else 0
        return Value(self.number, str(before | bits), self.strength)


@dataclass
class Satellite:
    """One satellite in one epoch: its observations by code."""

    name: str
    values: dict[str, Value]

    def of_kind(self, letter):
        """Codes of a kind: C pseudorange, L phase, D Doppler, S C/N0."""
        return [code for code in self.values if code[0] == letter]

    def best_cn0(self):
        return max((self.values[code].number for code in self.of_kind("S")), default=0.0)


@dataclass
class Epoch:
    """One epoch: seconds since the GPS epoch, its line up to the count, its satellites."""

    time: float
    line: str
    satellites: list[Satellite]

    def copy(self):
        satellites = [Satellite(one.name, dict(one.values)) for one in self.satellites]
        return Epoch(self.time, self.line, satellites)

    def ranged(self):
        """How many satellites have a pseudorange."""
        return sum(bool(one.of_kind("C")) for one in self.satellites)


@dataclass
class Observations:
    """A file: header lines, codes by constellation, GLONASS channels, epochs."""

    header: list[str]
    codes: dict[str, list[str]]
    channels: dict[str, int] = field(default_factory=dict)
    epochs: list[Epoch] = field(default_factory=list)

    def copy(self):
        epochs = [epoch.copy() for epoch in self.epochs]
        return Observations(self.header, self.codes, self.channels, epochs)

    def satellites(self):
        """Names of all satellites, sorted."""
        return sorted({one.name for epoch in self.epochs for one in epoch.satellites})

    def wavelength_m(self, satellite, code):
        band, system = code[1], satellite[0]
        if system == "R" and band in GLONASS_HZ:
            base, step = GLONASS_HZ[band]
            return SPEED_OF_LIGHT / (base + step * self.channels.get(satellite, 0))
        if system == "C" and band in BEIDOU_HZ:
            return SPEED_OF_LIGHT / BEIDOU_HZ[band]
        return SPEED_OF_LIGHT / DEFAULT_HZ.get(band, DEFAULT_HZ["1"])


def read(path):
    """Reads a file, gzip or plain."""
    opener = gzip.open if str(path).endswith(".gz") else open
    with opener(path, "rt", encoding="latin-1") as file:
        lines = file.read().replace("\r", "").replace("\0", " ").split("\n")
    if not lines[0][:9].strip().startswith("3"):
        raise UnsupportedFile(f"{path}: not RINEX 3")
    body = 1 + next(i for i, line in enumerate(lines) if line[LABEL_COLUMN:].startswith("END OF HEADER"))
    observations = _header(lines[:body])
    while body < len(lines):
        if not lines[body].startswith(">"):
            body += 1
            continue
        head = lines[body]
        count = int(head[32:35])
        rows = lines[body + 1 : body + 1 + count]
        body += 1 + count
        if head[31] in "01":
            satellites = [_satellite(row, observations.codes) for row in rows]
            observations.epochs.append(Epoch(_seconds(head), head[:32], satellites))
    return observations


def _header(lines):
    codes, channels, system = {}, {}, None
    for line in lines:
        label = line[LABEL_COLUMN:].strip()
        if label == "SYS / # / OBS TYPES":
            if line[SYSTEM_COLUMN] != " ":
                system = line[SYSTEM_COLUMN]
                codes[system] = []
            codes[system] += line[7:LABEL_COLUMN].split()
        elif label == "GLONASS SLOT / FRQ #":
            words = line[3:LABEL_COLUMN].replace("R", " R").split()
            channels.update(zip(words[::2], map(int, words[1::2])))
    return Observations(lines, codes, channels)


def _seconds(head):
    year, month, day, hour, minute = (int(word) for word in head[2:18].split())
    whole = datetime(year, month, day, hour, minute) - GPS_EPOCH
    return whole.total_seconds() + float(head[18:29])


def _satellite(row, codes):
    name = row[:3].replace(" ", "0")
    values = {}
    for index, code in enumerate(codes.get(name[0], [])):
        text = row[3 + FIELD_WIDTH * index : 3 + FIELD_WIDTH * (index + 1)].ljust(FIELD_WIDTH)
        if text[:VALUE_WIDTH].strip():
            values[code] = Value(float(text[:VALUE_WIDTH]), text[14], text[15])
    return Satellite(name, values)


def write(path, observations):
    """Writes a plain file."""
    with open(path, "w", encoding="latin-1") as file:
        file.write("\n".join(observations.header) + "\n")
        for epoch in observations.epochs:
            file.write(f"{epoch.line}{len(epoch.satellites):3d}\n")
            for satellite in epoch.satellites:
                file.write(_row(satellite, observations.codes) + "\n")


def _row(satellite, codes):
    cells = [satellite.name]
    for code in codes.get(satellite.name[0], []):
        value = satellite.values.get(code)
        fits = value is not None and -1e9 < value.number < 1e10
        cells.append(f"{value.number:14.3f}{value.lock}{value.strength}" if fits else " " * FIELD_WIDTH)
    return "".join(cells).rstrip()
