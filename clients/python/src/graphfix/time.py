"""GPS time as week and nanoseconds of the week."""

from datetime import datetime, timedelta

from .v1.observation_pb2 import GpsTime

_WEEK_NS = 604_800 * 10**9
_EPOCH = datetime(1980, 1, 6)


def gps_time(instant: datetime) -> GpsTime:
    """The instant that a date and time name on the scale of GPS, without leap seconds.

    UTC is 18 s behind GPS since 2017: a time zone is refused, so that nobody forgets them.
    """
    if instant.tzinfo is not None:
        raise ValueError("give GPS time without a time zone: unlike UTC it has no leap seconds")
    since = (instant - _EPOCH) // timedelta(microseconds=1) * 1000
    return GpsTime(week=since // _WEEK_NS, ns_of_week=since % _WEEK_NS)


def gps_seconds(time: GpsTime) -> float:
    """Seconds since 1980-01-06 on the scale of GPS; steps of 0.2 µs."""
    return time.week * 604_800 + time.ns_of_week / 1e9
