"""A simulated drive, and services to send it to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rinex
from service import START_S, Service, simulate

from graphfix import Client, Epoch

Start = Callable[..., Service]


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a rover and its base, 241 epochs under an open sky."""
    return simulate(tmp_path_factory.mktemp("drive"), "rtk-open", 240)


@pytest.fixture(scope="session")
def epochs(drive: Path) -> list[Epoch]:
    """The rover's epochs."""
    return rinex.epochs(drive / "rover.obs")


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts services, which end with the test."""
    started: list[Service] = []

    def start(**limits: int) -> Service:
        folder = tmp_path / f"service-{len(started)}"
        folder.mkdir()
        service = Service(folder, limits)
        started.append(service)
        service.start()
        return service

    yield start
    for service in started:
        service.kill()


@pytest.fixture
def service(start: Start) -> Service:
    """A service as it is by default."""
    return start()


@pytest.fixture
def client(service: Service, drive: Path) -> Iterator[Client]:
    """A client of that service, which has the ephemerides of the drive."""
    with Client(service.url, patience_s=START_S) as client:
        client.push_navigation((drive / "navigation.rnx").read_bytes())
        yield client
