"""Forwards the bytes of a receiver to a service, for as long as both run.

    python receiver.py tcp://192.168.1.20:5017 --session-file rover.session --mode fgo
    python receiver.py serial:///dev/ttyACM0?baud=115200 --session-file rover.session

The receiver sends UBX (RXM-RAWX, RXM-SFRBX) or RTCM 3 (MSM). The session's id is kept in a file, so
that a restart continues the session behind its last stored byte. Bytes that arrive while the
service does not answer wait in memory, up to `--megabytes`; then the receiver's connection waits.
"""

import argparse
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from graphfix import Client, Session, Status

PIECE_BYTES = 4096


def tcp(host: str, port: int) -> Iterator[bytes]:
    """The bytes of a receiver on a TCP port, connected again whenever it hangs up."""
    while True:
        try:
            with socket.create_connection((host, port), timeout=30) as connection:
                while piece := connection.recv(PIECE_BYTES):
                    yield piece
        except OSError as error:
            print(f"{host}:{port}: {error}")
        time.sleep(1)


def serial_line(device: str, baud: int) -> Iterator[bytes]:
    """The bytes of a receiver on a serial line."""
    import serial  # pip install pyserial

    with serial.Serial(device, baud, timeout=1) as line:
        while True:
            piece = line.read(max(1, min(line.in_waiting, PIECE_BYTES)))
            if piece:
                yield piece


def receiver(address: str) -> Iterator[bytes]:
    """The receiver that an address names."""
    parts = urlsplit(address)
    if parts.scheme == "tcp" and parts.hostname and parts.port:
        return tcp(parts.hostname, parts.port)
    if parts.scheme == "serial":
        return serial_line(parts.path, int(parse_qs(parts.query).get("baud", ["9600"])[0]))
    raise SystemExit(f"{address!r} is neither tcp://HOST:PORT nor serial:///dev/DEVICE?baud=RATE")


def same_session(client: Client, file: Path, mode: str) -> Session:
    """The session that the file names, or a new one."""
    if file.exists():
        return client.session(file.read_text().strip())
    session = client.create_session(mode=mode, label=file.stem)
    file.write_text(session.id)
    return session


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("receiver")
    parser.add_argument("--session-file", type=Path, required=True)
    parser.add_argument("--server", default="http://127.0.0.1:8080")
    parser.add_argument("--mode", default="spp")
    parser.add_argument("--megabytes", type=int, default=16)
    arguments = parser.parse_args()
    pieces = (arguments.megabytes << 20) // PIECE_BYTES
    key, ca_file = (os.environ.get(name) for name in ("GRAPHFIX_KEY", "GRAPHFIX_CA"))
    # No end of patience: the device stands on a roof.
    with Client(arguments.server, key=key, ca_file=ca_file, patience_s=None) as client:
        session = same_session(client, arguments.session_file, arguments.mode)
        print(f"session {session.id}, {session.raw_through} bytes stored")
        stream = session.stream_raw(
            receiver(arguments.receiver), answers="summary", read_ahead=max(8, pieces)
        )
        for answer in stream:
            if answer.summary is not None:
                status = Status.Name(answer.summary.status).removeprefix("STATUS_")
                place = answer.summary.position
                where = f"{place.latitude_deg:.8f} {place.longitude_deg:.8f} {place.height_m:.3f}"
                print(answer.seq, status, where if answer.summary.HasField("position") else "")
            elif answer.refusal is not None:
                print(answer.seq, answer.refusal.code, answer.refusal.message)


if __name__ == "__main__":
    main()
