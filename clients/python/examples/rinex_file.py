"""Plays a RINEX observation file to a service, and prints the solutions.

    python rinex_file.py rover.obs navigation.rnx --server http://127.0.0.1:8080 --mode fgo

The service decodes the file: RINEX 2.10 to 4.0x, CRINEX, UBX, RTCM 3 or an Android GnssLogger log,
plain or gzip. A file that was sent in part is continued with `--session`.
"""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

from graphfix import Client, Solution, Status


def chunks(path: Path, start: int, size: int = 64 << 10) -> Iterator[bytes]:
    """The file from a byte on."""
    with path.open("rb") as file:
        file.seek(start)
        while chunk := file.read(size):
            yield chunk


def line(solution: Solution) -> str:
    """A solution as text: UTC, degrees, metres."""
    status = Status.Name(solution.status).removeprefix("STATUS_")
    if not solution.HasField("position"):
        reasons = ", ".join(reason.code for reason in solution.reasons)
        return f"{solution.time_utc} {status} {reasons}"
    place = solution.position.geodetic
    return (
        f"{solution.time_utc} {status:6} {place.latitude_deg:.8f} {place.longitude_deg:.8f} "
        f"{place.height_m:.3f} with {len(solution.satellites_used)} satellites"
    )


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rover", type=Path)
    parser.add_argument("navigation", type=Path, nargs="*")
    parser.add_argument("--server", default="http://127.0.0.1:8080")
    parser.add_argument("--mode", default="spp")
    parser.add_argument("--session", help="continue this session")
    arguments = parser.parse_args()
    key, ca_file = (os.environ.get(name) for name in ("GRAPHFIX_KEY", "GRAPHFIX_CA"))
    with Client(arguments.server, key=key, ca_file=ca_file) as client:
        for path in arguments.navigation:
            client.push_navigation(path.read_bytes())
        if arguments.session:
            session = client.session(arguments.session)
        else:
            session = client.create_session(mode=arguments.mode, label=arguments.rover.name)
        print(f"session {session.id}")
        start = session.raw_through
        stream = session.stream_raw(chunks(arguments.rover, start), offset=start, end=True)
        for answer in stream:
            if answer.solution is not None:
                print(line(answer.solution))
            elif answer.refusal is not None:
                print(f"epoch {answer.seq}: {answer.refusal.code}: {answer.refusal.message}")


if __name__ == "__main__":
    main()
