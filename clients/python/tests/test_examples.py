"""The examples, run as a user runs them."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from service import START_S, Service

from graphfix import Client, Epoch

EXAMPLES = Path(__file__).parent.parent / "examples"


def command(name: str, *arguments: object) -> list[str]:
    """The command line of an example."""
    return [sys.executable, "-u", str(EXAMPLES / name), *map(str, arguments)]


def test_a_rinex_file(client: Client, service: Service, drive: Path, epochs: list[Epoch]) -> None:
    arguments = (drive / "rover.obs", drive / "navigation.rnx", "--server", service.url)
    output = subprocess.run(
        command("rinex_file.py", *arguments), check=True, capture_output=True, text=True
    ).stdout.splitlines()
    assert output[0].startswith("session ses_")
    assert len(output) == 1 + len(epochs)
    assert output[-1].startswith("2026-01-01T0") and " SINGLE " in output[-1], output[-1]


@pytest.fixture
def receiver(drive: Path) -> Iterator[str]:
    """A receiver on a TCP port that sends a file, and hangs up in its middle."""
    content = (drive / "rover.obs").read_bytes()
    half = len(content) // 2
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        for part in (content[:half], content[half:]):
            connection, _ = server.accept()
            with connection:
                connection.sendall(part)

    threading.Thread(target=serve, daemon=True).start()
    yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
    server.close()


def test_a_receiver_on_tcp(
    client: Client, service: Service, receiver: str, epochs: list[Epoch], tmp_path: Path
) -> None:
    file = tmp_path / "rover.session"
    arguments = command("receiver.py", receiver, "--session-file", file, "--server", service.url)
    device = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
    assert device.stdout is not None
    ended = threading.Timer(START_S, device.kill)
    ended.start()
    try:
        numbers = [int(line.split()[0]) for line in _until(device.stdout, len(epochs))]
    finally:
        ended.cancel()
        device.kill()
        device.wait()
    assert numbers == [epoch.seq for epoch in epochs]
    session = client.session(file.read_text())
    assert session.durable_through == len(epochs)


def _until(lines: Iterator[str], count: int) -> Iterator[str]:
    """The lines of so many epochs."""
    for line in lines:
        if line.split()[0].isdigit():
            yield line
            count -= 1
            if count == 0:
                return


def test_a_fleet(client: Client, service: Service, epochs: list[Epoch]) -> None:
    sessions = [client.create_session(label=f"rover {number}") for number in range(2)]
    for session in sessions:
        assert len(list(session.stream(epochs[:10]))) == 10
    arguments = command("fleet.py", "--server", service.url, "--solutions", 40)
    watcher = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
    assert watcher.stdout is not None
    ended = threading.Timer(START_S, watcher.kill)
    ended.start()
    try:
        # The heads are listed before epochs go on.
        listed = [watcher.stdout.readline() for _ in sessions]
        for session in sessions:
            list(session.stream(epochs[10:30]))
        lines = watcher.stdout.read().splitlines()
    finally:
        ended.cancel()
        watcher.kill()
        watcher.wait()
    assert all("SINGLE" in line and line.rstrip().split()[-2] == "rover" for line in listed), listed
    for number in range(2):
        seen = [line for line in lines if line.startswith(f"rover {number} ")]
        assert [int(line.split(" epoch ")[1].split()[0]) for line in seen] == list(range(11, 31))
