"""Client of the GNSS positioning service Graphfix.

    from graphfix import Client

    with Client("http://127.0.0.1:8080") as client:
        session = client.create_session(mode="rtk-fgo", base="nearest")
        for answer in session.stream(epochs):
            print(answer.seq, answer.solution)

`graphfix.v1` has all messages, as `proto/` of the project defines them. Times are GPS time, lengths
metres, angles degrees.
"""

from ._device_stream import Answer, DeviceStream
from .client import Client
from .errors import GraphfixError, ServiceUnreachableError
from .session import Session
from .time import gps_seconds, gps_time
from .v1.observation_pb2 import Epoch, GpsTime, Observation
from .v1.solution_pb2 import Solution, Status

__all__ = [
    "Answer",
    "Client",
    "DeviceStream",
    "Epoch",
    "GpsTime",
    "GraphfixError",
    "Observation",
    "ServiceUnreachableError",
    "Session",
    "Solution",
    "Status",
    "gps_seconds",
    "gps_time",
]
