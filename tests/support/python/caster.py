"""An NTRIP caster that nobody here wrote: pygnssutils'. What comes on standard input is its stream.

Arguments: port, version of NTRIP ("1.0" or "2.0"), user, password.
"""

import sys
from queue import Queue
from threading import Thread

from pygnssutils.socket_server import ClientHandler, SocketServer


def main() -> None:
    port, version, user, password = sys.argv[1:]
    messages: Queue = Queue()
    server = SocketServer(
        None,
        1,
        5,
        messages,
        ("127.0.0.1", int(port)),
        ClientHandler,
        ntripversion=version,
        ntripuser=user,
        ntrippassword=password,
    )
    Thread(target=server.serve_forever, daemon=True).start()
    while piece := sys.stdin.buffer.read1(4096):
        messages.put(piece)


main()
