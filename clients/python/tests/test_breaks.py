"""Streams and watches across breaks: nothing is lost, nothing comes twice."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import Start
from service import START_S, Service, replay

from graphfix import Answer, Client, Epoch, Solution

# Numbers of the answers after which the service ends.
BREAKS = (20, 60, 61, 120, 200)


@pytest.fixture
def service(start: Start) -> Service:
    """A service that gives little credit, so that it never has all epochs at once."""
    return start(stream_epochs=16)


def positions(answers: list[Answer]) -> list[tuple[int, Solution]]:
    """Number and solution of each answer; none may be refused."""
    solutions = [(answer.seq, answer.solution) for answer in answers]
    assert all(solution is not None for _, solution in solutions), answers
    return [(seq, solution) for seq, solution in solutions if solution is not None]


def undisturbed(client: Client, epochs: list[Epoch], mode: str) -> list[tuple[int, Solution]]:
    """The same epochs without a break."""
    return positions(list(client.create_session(mode=mode).stream(epochs)))


@pytest.mark.parametrize("mode", ["spp", "fgo"])
def test_kill_9_in_the_middle_of_a_stream(
    client: Client, service: Service, epochs: list[Epoch], mode: str
) -> None:
    expected = undisturbed(client, epochs, mode)
    session = client.create_session(mode=mode)
    answers: list[Answer] = []
    stream = session.stream(epochs, patience_s=START_S)
    for answer in stream:
        answers.append(answer)
        if answer.seq in BREAKS:
            service.kill()
            service.start()
    assert stream.breaks >= 3
    assert positions(answers) == expected, "lost, doubled or other bits"
    stored = list(session.solutions(revisions="first"))
    assert stored == [solution for _, solution in expected]
    replay(service.database, session.id)


def test_kill_9_at_any_moment(client: Client, service: Service, epochs: list[Epoch]) -> None:
    """The service ends while epochs are on their way, not only where an answer is taken."""
    session = client.create_session(mode="spp")
    is_over = threading.Event()

    def ends() -> None:
        # Moments that do not depend on the answers.
        for delay_s in (0.05, 0.3, 0.1, 0.4, 0.2, 0.5):
            while not service.is_ready() and not is_over.is_set():
                is_over.wait(0.02)
            is_over.wait(delay_s)
            service.kill()
            service.start()

    def paced() -> Iterator[Epoch]:
        for epoch in epochs:
            yield epoch
            is_over.wait(0.01)

    thread = threading.Thread(target=ends)
    thread.start()
    try:
        stream = session.stream(paced(), patience_s=START_S)
        answers = list(stream)
    finally:
        is_over.set()
        thread.join()
    assert [answer.seq for answer in answers] == [epoch.seq for epoch in epochs]
    assert stream.breaks > 0
    assert [solution for _, solution in positions(answers)] == list(
        session.solutions(revisions="first")
    )


def test_an_operators_stop_and_start(client: Client, service: Service, epochs: list[Epoch]) -> None:
    session = client.create_session(mode="spp")
    answers: list[Answer] = []
    with session.stream(epochs, patience_s=START_S) as stream:
        for answer in stream:
            answers.append(answer)
            if answer.seq == 50:
                service.stop()
                service.start()
    assert stream.breaks >= 1
    assert [seq for seq, _ in positions(answers)] == [epoch.seq for epoch in epochs]


def test_silent_answers_across_a_kill(
    client: Client, service: Service, epochs: list[Epoch]
) -> None:
    session = client.create_session()
    durable: list[int] = []

    def on_durable(through: int) -> None:
        if not durable:
            service.kill()
            service.start()
        durable.append(through)

    stream = session.stream(epochs, answers="none", patience_s=START_S, on_durable=on_durable)
    assert list(stream) == []
    assert durable == sorted(set(durable)) and durable[-1] == epochs[-1].seq
    stored = [solution.seq for solution in session.solutions()]
    assert stored == [epoch.seq for epoch in epochs]


def test_kill_9_in_the_middle_of_raw_bytes(
    client: Client, service: Service, drive: Path, epochs: list[Epoch]
) -> None:
    content = (drive / "rover.obs").read_bytes()
    chunks = [content[at : at + 5000] for at in range(0, len(content), 5000)]
    expected = undisturbed(client, epochs, "spp")
    session = client.create_session(mode="spp")
    answers: list[Answer] = []
    durable: list[int] = []
    stream = session.stream_raw(chunks, end=True, on_durable=durable.append, patience_s=START_S)
    for answer in stream:
        answers.append(answer)
        if answer.seq in BREAKS:
            service.kill()
            service.start()
    assert stream.breaks >= 3
    got = [(seq, solution.position) for seq, solution in positions(answers)]
    assert got == [(seq, solution.position) for seq, solution in expected]
    assert durable == sorted(set(durable)) and durable[-1] == len(content)
    assert session.refresh().raw_through == len(content)
    replay(service.database, session.id)


def test_raw_bytes_go_on_where_another_device_ended(
    client: Client, drive: Path, epochs: list[Epoch]
) -> None:
    content = (drive / "rover.obs").read_bytes()
    half = len(content) // 2
    session = client.create_session(mode="spp")
    reports: list[str] = []
    first = list(session.stream_raw([content[:half]], on_report=lambda r: reports.append(r.format)))
    assert reports[-1] == "rinex"
    assert session.refresh().raw_through == half
    rest = list(session.stream_raw([content[half:]], end=True))
    assert [answer.seq for answer in first + rest] == [epoch.seq for epoch in epochs]


def test_a_watch_goes_on_behind_its_cursor(
    client: Client, service: Service, epochs: list[Epoch]
) -> None:
    session = client.create_session(mode="fgo")
    watched: list[tuple[int, int]] = []
    cursors: list[str] = []
    failures: list[BaseException] = []

    def watch() -> None:
        try:
            for message in client.session(session.id).watch(after_seq=0):
                watched.extend((known.seq, known.revision) for known in message.solutions)
                cursors.append(message.cursor)
        except BaseException as failure:
            failures.append(failure)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    for answer in session.stream(epochs, patience_s=START_S):
        if answer.seq in BREAKS:
            service.kill()
            service.start()
    session.close()
    thread.join(START_S)
    assert not thread.is_alive() and not failures, failures
    assert len(watched) == len(set(watched)), "a solution came twice"
    stored = {(known.seq, known.revision) for known in session.solutions(revisions="all")}
    assert set(watched) == stored
    firsts = [seq for seq, revision in watched if revision == 0]
    assert firsts == [epoch.seq for epoch in epochs]
    # A reader that restarts: what follows one of the cursors, and nothing before it.
    rest = [
        (known.seq, known.revision)
        for message in session.watch(cursor=cursors[len(cursors) // 2])
        for known in message.solutions
    ]
    assert rest and set(rest) == set(watched[len(watched) - len(rest) :])
