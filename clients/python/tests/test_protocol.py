"""What a device sends where a break falls between two answers; without a service."""

from __future__ import annotations

from collections.abc import Iterator

import grpc

from graphfix import Epoch
from graphfix._cargo import Epochs, RawBytes
from graphfix._device_stream import DeviceStream, StreamOptions
from graphfix.v1.positioning_pb2 import (
    ANSWERS_FULL,
    StreamCredit,
    StreamOpened,
    StreamRawCredit,
    StreamRawOpened,
    StreamRawRequest,
    StreamRawResponse,
    StreamRequest,
    StreamResponse,
    StreamResult,
)
from graphfix.v1.solution_pb2 import Solution

# Number of the last epoch that the service has when the device connects.
STORED = 1000
CREDIT = StreamCredit(epochs=4, bytes=1 << 16)


class BrokenError(grpc.RpcError):
    """A connection that breaks."""

    def code(self) -> grpc.StatusCode:
        return grpc.StatusCode.UNAVAILABLE

    def details(self) -> str:
        return "connection reset"

    def trailing_metadata(self) -> tuple[()]:
        return ()


class Script:
    """A service whose first stream breaks after some epochs, before any answer."""

    def __init__(self, received_before_break: int) -> None:
        self.left = received_before_break
        self.openings: list[StreamRequest] = []
        self.is_second = False

    def __call__(self, requests: Iterator[StreamRequest]) -> Script:
        self.requests = requests
        return self

    def cancel(self) -> None:
        """Nothing is open."""

    def __iter__(self) -> Iterator[StreamResponse]:
        opening = next(self.requests)
        self.openings.append(opening)
        opened = StreamOpened(durable_through=STORED, idle_s=300)
        yield StreamResponse(opened=opened, durable_through=STORED, credit=CREDIT)
        if not self.is_second:
            self.is_second = True
            for _ in range(self.left):
                next(self.requests)
            raise BrokenError
        after = opening.opening.last_acknowledged
        missed = [StreamResult(seq=seq, solution=Solution(seq=seq)) for seq in range(after + 1, 6)]
        yield StreamResponse(durable_through=STORED, credit=CREDIT, results=missed)
        for request in self.requests:
            seq = request.epochs[0].seq
            result = StreamResult(seq=seq, solution=Solution(seq=seq))
            through = max(STORED, seq)
            yield StreamResponse(durable_through=through, credit=CREDIT, results=[result])


class RawScript:
    """A service that stores bytes, and whose first streams break before the end is processed."""

    def __init__(self, breaks: int, through: int = 0) -> None:
        self.left = breaks
        self.through = through
        self.streams = 0
        self.is_ended = False

    def __call__(self, requests: Iterator[StreamRawRequest]) -> RawScript:
        self.requests = requests
        return self

    def cancel(self) -> None:
        """Nothing is open."""

    def __iter__(self) -> Iterator[StreamRawResponse]:
        self.streams += 1
        next(self.requests)
        opened = StreamRawOpened(raw_through=self.through, idle_s=300)
        credit = StreamRawCredit(chunks=100, bytes=1 << 20)
        yield StreamRawResponse(opened=opened, raw_through=self.through, credit=credit)
        for request in self.requests:
            if request.end and self.left:
                # The bytes are acknowledged while the end is on its way.
                self.left -= 1
                yield StreamRawResponse(raw_through=self.through, credit=credit)
                raise BrokenError
            self.through = max(self.through, request.offset + len(request.content))
            self.is_ended = self.is_ended or request.end
            if request.end:
                yield StreamRawResponse(raw_through=self.through, credit=credit)


def options() -> StreamOptions:
    """Full answers, from nothing."""
    return StreamOptions(
        has_answers=True, last_acknowledged=None, read_ahead=8, patience_s=5, on_durable=None
    )


def test_old_epochs_whose_answers_were_lost_are_answered() -> None:
    """A device that repeats stored epochs, and loses the connection before the first answer."""
    service = Script(received_before_break=3)
    epochs = [Epoch(seq=seq) for seq in range(1, 5)]
    stream = DeviceStream(service, Epochs("ses_1", ANSWERS_FULL), epochs, options())
    answers = [answer.seq for answer in stream]
    first, second = (request.opening for request in service.openings)
    assert not first.HasField("last_acknowledged")
    assert second.last_acknowledged == 0
    assert answers[:4] == [1, 2, 3, 4]
    assert len(answers) == len(set(answers))


def test_new_epochs_do_not_bring_old_answers() -> None:
    """A device that goes on behind what is stored gets nothing from before."""
    service = Script(received_before_break=2)
    epochs = [Epoch(seq=seq) for seq in range(STORED + 1, STORED + 4)]
    stream = DeviceStream(service, Epochs("ses_1", ANSWERS_FULL), epochs, options())
    answers = [answer.seq for answer in stream]
    assert service.openings[1].opening.last_acknowledged == STORED
    assert answers == [STORED + 1, STORED + 2, STORED + 3]
    assert stream.breaks == 1


def test_the_end_of_a_receiver_is_sent_until_it_is_processed() -> None:
    """Without it, the service would keep the last epoch of the bytes back for ever."""
    for breaks in range(3):
        service = RawScript(breaks)
        cargo = RawBytes("ses_1", ANSWERS_FULL, offset=0, near=None, has_end=True)
        stream = DeviceStream(service, cargo, [b"x" * 1000], options())
        assert list(stream) == []
        assert (service.is_ended, stream.stored_through) == (True, 1000)
        assert (stream.breaks, service.streams) == (breaks, breaks + 1)


def test_an_end_without_new_bytes_is_sent() -> None:
    service = RawScript(breaks=0, through=1000)
    cargo = RawBytes("ses_1", ANSWERS_FULL, offset=1000, near=None, has_end=True)
    assert list(DeviceStream(service, cargo, [], options())) == []
    assert service.is_ended
