"""Solution and truth files, and errors east, north, up."""

import bisect
import csv
import math
from dataclasses import dataclass

WEEK_S = 604_800.0
# WGS 84: semi-major axis (m), flattening.
AXIS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257_223_563
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
# Without a truth on both sides, one this near in time counts (s).
NEAREST_S = 0.02
# Longer gaps of the truth are not interpolated (s).
WIDEST_GAP_S = 1.5
# Larger coordinates are metres from the Earth's centre, not degrees.
LARGEST_ANGLE = 1000.0


def to_ecef(latitude_deg, longitude_deg, height_m):
    """Geodetic to Earth-centred Earth-fixed (m)."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    normal = AXIS_M / math.sqrt(1.0 - ECCENTRICITY_2 * math.sin(latitude) ** 2)
    flat = (normal + height_m) * math.cos(latitude)
    up = (normal * (1.0 - ECCENTRICITY_2) + height_m) * math.sin(latitude)
    return flat * math.cos(longitude), flat * math.sin(longitude), up


def axes(place):
    """Unit vectors east, north, up at a place: the ellipsoid's normal by Bowring's (1976) formula."""
    x, y, z = place
    flat = math.hypot(x, y)
    polar_axis = AXIS_M * (1.0 - FLATTENING)
    second = ECCENTRICITY_2 / (1.0 - ECCENTRICITY_2)
    reduced = math.atan2(z * AXIS_M, flat * polar_axis)
    latitude = math.atan2(
        z + second * polar_axis * math.sin(reduced) ** 3,
        flat - ECCENTRICITY_2 * AXIS_M * math.cos(reduced) ** 3,
    )
    sin_p, cos_p = math.sin(latitude), math.cos(latitude)
    sin_l, cos_l = (y / flat, x / flat) if flat else (0.0, 1.0)
    return (
        (-sin_l, cos_l, 0.0),
        (-sin_p * cos_l, -sin_p * sin_l, cos_p),
        (cos_p * cos_l, cos_p * sin_l, sin_p),
    )


def to_enu(place, origin):
    """East, north, up of a position from an origin (m)."""
    offset = [a - b for a, b in zip(place, origin)]
    return tuple(sum(c * d for c, d in zip(axis, offset)) for axis in axes(origin))


def moved(origin, enu):
    """The position at an offset east, north, up (m) from an origin."""
    east, north, up = axes(origin)
    return tuple(o + enu[0] * e + enu[1] * n + enu[2] * u for o, e, n, u in zip(origin, east, north, up))


@dataclass(frozen=True)
class Answer:
    """One row of a solution file; `place` is None where the status is NONE."""

    time: float
    status: str
    place: tuple | None = None
    # Stated variances east and north and their covariance (m²).
    covariance: tuple | None = None
    # Stated probability that a fix is right.
    probability: float | None = None
    # Stated horizontal and vertical protection levels (m).
    protection: tuple | None = None


def read_answers(path):
    """Rows of a solution CSV in order of time; of several at one time the last with a position."""
    answers = {}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            answer = _answer(row)
            if answer.place is not None or answer.time not in answers:
                answers[answer.time] = answer
    return [answers[time] for time in sorted(answers)]


def _answer(row):
    def numbers(*names):
        values = [row.get(name) for name in names]
        return tuple(map(float, values)) if all(values) else None

    probability = numbers("fix_probability")
    return Answer(
        round(int(row["gps_week"]) * WEEK_S + float(row["tow_s"]), 3),
        row["status"],
        numbers("x_m", "y_m", "z_m"),
        numbers("var_e_m2", "var_n_m2", "cov_en_m2"),
        probability and probability[0],
        numbers("hpl_m", "vpl_m"),
    )


class Truth:
    """Where the antenna truly was: places in order of time, or one place without a time."""

    def __init__(self, times, places, lever=None):
        self.times, self.places, self.lever = times, places, lever

    @classmethod
    def read(cls, path, lever=None):
        """`gps_week,tow` and latitude, longitude, height or x, y, z; the first of equal times."""
        rows = {}
        with open(path, encoding="utf-8") as file:
            for line in file:
                try:
                    week, tow, *place = [float(word) for word in line.split(",")[:5]]
                except ValueError:
                    continue  # a title or a comment
                is_ecef = LARGEST_ANGLE < abs(place[0])
                rows.setdefault(week * WEEK_S + tow, tuple(place) if is_ecef else to_ecef(*place))
        times = sorted(rows)
        return cls(times, [rows[time] for time in times], lever)

    @classmethod
    def fixed(cls, place, lever=None):
        """One place at all times."""
        return cls([], [place], lever)

    def at(self, time):
        """The place at a time; None where the truth has a gap."""
        place = self._point(time)
        return moved(place, self.lever) if place and self.lever else place

    def _point(self, time):
        if not self.times:
            return self.places[0]
        after = bisect.bisect_left(self.times, time)
        if after < len(self.times) and self.times[after] == time:
            return self.places[after]
        if 0 < after < len(self.times):
            begin, end = self.times[after - 1], self.times[after]
            if end - begin <= WIDEST_GAP_S:
                weight = (time - begin) / (end - begin)
                pairs = zip(self.places[after - 1], self.places[after])
                return tuple(a + weight * (b - a) for a, b in pairs)
        near = [i for i in (after - 1, after) if 0 <= i < len(self.times)]
        nearest = min(near, key=lambda i: abs(self.times[i] - time))
        return self.places[nearest] if abs(self.times[nearest] - time) <= NEAREST_S else None
