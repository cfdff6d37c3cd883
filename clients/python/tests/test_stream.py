"""Streams of epochs with a service that runs."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import Start
from service import START_S, Service

from graphfix import Client, Epoch, GraphfixError, ServiceUnreachableError, Status


def copy(epoch: Epoch) -> Epoch:
    """An epoch that may be changed."""
    other = Epoch()
    other.CopyFrom(epoch)
    return other


def test_each_epoch_is_answered_once_with_what_is_stored(
    client: Client, epochs: list[Epoch]
) -> None:
    session = client.create_session(mode="spp", label="all")
    durable: list[int] = []
    with session.stream(epochs, on_durable=durable.append) as stream:
        answers = list(stream)
    assert [answer.seq for answer in answers] == [epoch.seq for epoch in epochs]
    assert stream.breaks == 0
    assert durable == sorted(set(durable)) and durable[-1] == epochs[-1].seq
    # Seven solutions a page: the last page is not full.
    stored = list(session.solutions(revisions="first", page_size=7))
    assert [answer.solution for answer in answers] == stored
    assert sum(solution.status == Status.STATUS_SINGLE for solution in stored) > 200


def test_summaries_and_silence(client: Client, epochs: list[Epoch]) -> None:
    session = client.create_session()
    first, rest = epochs[:20], epochs[20:40]
    summaries = [answer.summary for answer in session.stream(first, answers="summary")]
    solutions = list(session.solutions(revisions="first"))
    assert len(summaries) == len(solutions) == 20
    for summary, solution in zip(summaries, solutions, strict=True):
        assert summary is not None
        assert summary.status == solution.status
        assert summary.position == solution.position.geodetic
    silent = session.stream(rest, answers="none")
    assert list(silent) == []
    assert silent.durable_through == rest[-1].seq


def test_a_restarted_device_gets_the_answers_that_it_has_not_seen(
    client: Client, epochs: list[Epoch]
) -> None:
    session = client.create_session()
    stored = list(session.stream(epochs[:30]))
    again = session.stream(epochs[20:40], last_acknowledged=10)
    answers = list(again)
    assert [answer.seq for answer in answers] == list(range(11, 41))
    assert answers[:20] == stored[10:]
    # Without that number: the answers to what is sent.
    assert list(session.stream(epochs[20:25])) == stored[20:25]
    with pytest.raises(GraphfixError) as raised:
        list(session.stream(epochs[40:], last_acknowledged=1000))
    assert raised.value.code == "ACKNOWLEDGEMENT_UNKNOWN"
    assert raised.value.field == "opening.lastAcknowledged"


def test_a_refused_epoch_is_an_answer(client: Client, epochs: list[Epoch]) -> None:
    session = client.create_session()
    changed = copy(epochs[4])
    changed.observations[0].pseudorange_m += 1
    late = copy(epochs[3])
    late.seq = 11
    answers = list(session.stream([*epochs[:10], changed, late]))
    assert [answer.seq for answer in answers] == [*range(1, 11), 5, 11]
    codes = [answer.refusal.code for answer in answers if answer.refusal is not None]
    assert codes[0] == "SEQUENCE_CONFLICT", codes
    assert len(codes) == 2 and answers[-1].refusal is not None, codes
    session.refresh()
    assert session.durable_through == 10


def test_a_wrong_message_ends_the_stream_after_the_answers_before(
    client: Client, epochs: list[Epoch]
) -> None:
    session = client.create_session()
    wrong = copy(epochs[5])
    wrong.observations[2].satellite = "X99"
    answered: list[int] = []
    with pytest.raises(GraphfixError) as raised:
        for answer in session.stream([*epochs[:5], wrong, *epochs[6:9]]):
            answered.append(answer.seq)
    assert raised.value.code == "INVALID_SATELLITE"
    assert raised.value.field == "epochs[0].observations[2].satellite"
    assert raised.value.remedy and not raised.value.is_passing
    assert answered == [1, 2, 3, 4, 5]


def test_what_the_source_raises_comes_after_the_answers(
    client: Client, epochs: list[Epoch]
) -> None:
    def failing() -> Iterator[Epoch]:
        yield from epochs[:5]
        raise OSError("the receiver is unplugged")

    answered: list[int] = []
    with pytest.raises(OSError, match="unplugged"):
        for answer in client.create_session().stream(failing()):
            answered.append(answer.seq)
    assert answered == [1, 2, 3, 4, 5]


def test_only_what_has_credit_is_in_memory(start: Start, epochs: list[Epoch]) -> None:
    service = start(stream_epochs=16)
    given: list[int] = []
    is_stalled = threading.Event()

    def source() -> Iterator[Epoch]:
        for epoch in epochs:
            given.append(epoch.seq)
            yield epoch
        is_stalled.set()

    with Client(service.url, patience_s=START_S) as client:
        session = client.create_session()
        with session.stream(source(), read_ahead=4) as stream:
            answers = iter(stream)
            for taken in range(1, 11):
                assert next(answers).seq == taken
            # Nobody takes answers now: the source must not be read to its end.
            assert not is_stalled.wait(2)
            # Credit; what waits; and the answers that are at hand, no more than the credit.
            assert len(given) <= 10 + 16 + 16 + 4 + 1, given[-1]
            assert [answer.seq for answer in answers] == list(range(11, len(epochs) + 1))


def test_a_silent_device_stays_connected(start: Start, epochs: list[Epoch]) -> None:
    service = start(stream_idle_s=1)

    def source() -> Iterator[Epoch]:
        yield epochs[0]
        # Three times the service's patience.
        threading.Event().wait(3)
        yield epochs[1]

    with Client(service.url, patience_s=START_S) as client:
        stream = client.create_session().stream(source())
        assert [answer.seq for answer in stream] == [1, 2]
        assert stream.breaks == 0


def test_an_epoch_that_no_credit_can_carry_is_refused_here(
    start: Start, epochs: list[Epoch]
) -> None:
    service = start(stream_bytes=1024)
    assert epochs[0].ByteSize() > 1024
    with Client(service.url, patience_s=START_S) as client:
        with pytest.raises(GraphfixError) as raised:
            list(client.create_session().stream(epochs[:2]))
    assert raised.value.code == "CREDIT_EXCEEDED"


def test_leaving_the_loop_ends_the_stream(client: Client, epochs: list[Epoch]) -> None:
    session = client.create_session()
    for answer in session.stream(epochs):
        if answer.seq == 50:
            break
    rest = [answer.seq for answer in session.stream(epochs[50:])]
    assert rest == list(range(51, len(epochs) + 1))


def test_a_service_that_is_not_there_ends_the_patience() -> None:
    began = time.monotonic()
    with Client("http://127.0.0.1:9", patience_s=0.5) as client:
        with pytest.raises(ServiceUnreachableError):
            client.create_session()
        with pytest.raises(ServiceUnreachableError):
            client.session("ses_1")
    # Not the time for an answer, which is a minute.
    assert time.monotonic() - began < 20


def test_refusals_have_code_field_and_remedy(client: Client) -> None:
    with pytest.raises(GraphfixError) as raised:
        client.create_session(mode="guess")
    assert raised.value.code == "UNKNOWN_MODE"
    assert raised.value.field == "mode"
    assert "modes" in raised.value.remedy and not raised.value.is_passing
    with pytest.raises(GraphfixError) as raised:
        client.session("ses_0")
    assert raised.value.code == "SESSION_NOT_FOUND"


def test_a_key_is_not_sent_in_the_clear() -> None:
    with pytest.raises(ValueError, match="https"):
        Client("http://gnss.example.org", key="secret")
    with pytest.raises(ValueError, match="address"):
        Client("gnss.example.org:8080")


def test_a_rover_relative_to_a_base(
    client: Client, service: Service, drive: Path, epochs: list[Epoch]
) -> None:
    base = client.create_base()
    uploaded = client.upload_base(base.base, (drive / "base.obs").read_bytes())
    assert uploaded.epochs == uploaded.new_epochs == len(epochs)
    assert [known.base for known in client.bases(page_size=1)] == [base.base]
    session = client.create_session(mode="rtk-fgo", base=base.base)
    statuses = [
        answer.solution.status
        for answer in session.stream(epochs[:60])
        if answer.solution is not None
    ]
    assert len(statuses) == 60
    assert statuses.count(Status.STATUS_FIXED) > 30, statuses
    track = b"".join(session.track("pos"))
    assert track.count(b"\n") > 60
    session.close()
    with pytest.raises(GraphfixError) as raised:
        list(session.stream(epochs[60:]))
    assert raised.value.code == "SESSION_CLOSED"
