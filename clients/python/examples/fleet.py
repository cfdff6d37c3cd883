"""Lists the sessions of a service, and follows the solutions of all that are open.

    python fleet.py --server http://127.0.0.1:8080

Each session has a thread that watches it. The threads share a queue of bounded length: if this
program is slow, the watches wait, and the service goes on without them.
"""

import argparse
import os
import queue
import threading

from graphfix import Client, GraphfixError, Solution, Status
from graphfix.v1.sessions_pb2 import SessionHead


def row(head: SessionHead) -> str:
    """A session at a glance: degrees, metres, seconds since its last epoch."""
    status = Status.Name(head.status).removeprefix("STATUS_")
    age = f"{head.age_s:.0f} s ago" if head.HasField("age_s") else "no epoch"
    place = head.position
    where = f"{place.latitude_deg:.7f} {place.longitude_deg:.7f} {place.height_m:.1f}"
    position = where if head.HasField("position") else "no position"
    return f"{head.session} {head.mode:8} {status:7} {position}, {age} {head.label}"


def follow(client: Client, head: SessionHead, found: "queue.Queue[tuple[str, Solution]]") -> None:
    """Puts the new solutions of a session into the queue, until it is closed."""
    try:
        session = client.session(head.session)
        for message in session.watch(after_seq=head.last_seq, revisions="first"):
            for solution in message.solutions:
                found.put((head.label or head.session, solution))
    except GraphfixError as error:
        print(f"{head.session}: {error}")


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--server", default="http://127.0.0.1:8080")
    parser.add_argument("--most", type=int, default=100, help="sessions to follow at most")
    parser.add_argument("--solutions", type=int, help="end after so many solutions")
    arguments = parser.parse_args()
    found: queue.Queue[tuple[str, Solution]] = queue.Queue(maxsize=1000)
    key, ca_file = (os.environ.get(name) for name in ("GRAPHFIX_KEY", "GRAPHFIX_CA"))
    with Client(arguments.server, key=key, ca_file=ca_file) as client:
        heads = list(client.heads())
        for head in heads:
            print(row(head))
        for head in [head for head in heads if not head.closed][: arguments.most]:
            threading.Thread(target=follow, args=(client, head, found), daemon=True).start()
        count = 0
        while arguments.solutions is None or count < arguments.solutions:
            name, solution = found.get()
            count += 1
            status = Status.Name(solution.status).removeprefix("STATUS_")
            print(f"{name} {solution.time_utc} epoch {solution.seq} {status}")


if __name__ == "__main__":
    main()
