"""A `graphfix serve` in a process of its own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import urllib.error
import urllib.request
from collections.abc import Sequence
from pathlib import Path

PROGRAM = os.environ.get("GRAPHFIX_PROGRAM", "graphfix")
# A program of profile `dev` on a busy machine.
START_S = 60


class Service:
    """A service on a database of its own, which outlives its process."""

    def __init__(
        self, folder: Path, limits: dict[str, int] | None = None, more: Sequence[str] = ()
    ) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self.database = f"sqlite://{folder / 'graphfix.db'}"
        self._configuration = folder / "graphfix.toml"
        lines = [f"{name} = {value}" for name, value in (limits or {}).items()]
        self._configuration.write_text("\n".join(["[limits]", *lines, ""]))
        self._more = more
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Starts the process; it need not be ready yet."""
        arguments = ["serve", "--log", "error", "--config", str(self._configuration)]
        arguments += ["--listen", f"127.0.0.1:{self.port}", "--database", self.database]
        arguments += self._more
        self._process = subprocess.Popen([PROGRAM, *arguments], stdin=subprocess.DEVNULL)

    def is_ready(self) -> bool:
        """Whether the service takes epochs."""
        try:
            with urllib.request.urlopen(f"{self.url}/readyz", timeout=5) as answer:
                return bool(answer.status == 200)
        except (urllib.error.URLError, OSError):
            return False

    def kill(self) -> None:
        """`kill -9`."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """The stop of an operator: streams are told to end."""
        self._end(signal.SIGTERM)

    def _end(self, number: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(number)
            self._process.wait(START_S)
            self._process = None


def simulate(folder: Path, scenario: str, duration_s: int) -> Path:
    """A folder with the files of a simulated rover and its base."""
    arguments = ["simulate", "--scenario", scenario, "--seed", "1", "--output", str(folder)]
    arguments += ["--duration", str(duration_s)]
    subprocess.run([PROGRAM, *arguments], check=True, stdout=subprocess.DEVNULL)
    return folder


def replay(database: str, session: str) -> str:
    """The output of a replay that must give the same bits."""
    command = [PROGRAM, "replay", session, "--database", database]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
