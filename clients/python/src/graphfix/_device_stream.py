"""A device's stream of one session: sends within the credit, keeps what is not durable yet, and
opens another stream where one ended."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Protocol, TypeVar

import grpc

from ._cargo import Cargo, Message, Reading
from ._outbox import Link, Outbox
from ._retry import Retry
from .errors import GraphfixError, from_rpc, unreachable
from .v1.positioning_pb2 import (
    Refusal,
    StreamEnding,
    StreamRawReport,
    StreamResult,
    StreamSummary,
)
from .v1.solution_pb2 import Solution

ItemT = TypeVar("ItemT")
RequestT = TypeVar("RequestT")
ResponseT = TypeVar("ResponseT")
ResponseCo = TypeVar("ResponseCo", covariant=True)


class Call(Protocol[ResponseCo]):
    """A stream of gRPC that is open."""

    def __iter__(self) -> Iterator[ResponseCo]:
        """The answers, until the stream ends."""

    def cancel(self) -> object:
        """Ends the stream."""


@dataclass(frozen=True)
class Answer:
    """The outcome of one epoch: a solution, its summary, or a refusal.

    Times are GPS time. Positions are Earth-centred, Earth-fixed (WGS 84; relative to a base, in the
    frame of its coordinates; or in the frame that the session asks for) and geodetic: metres and
    degrees, height above the ellipsoid.
    """

    seq: int
    solution: Solution | None = None
    summary: StreamSummary | None = None
    refusal: Refusal | None = None


@dataclass(frozen=True)
class StreamOptions:
    """How a device streams."""

    # Whether the service sends a solution for each epoch.
    has_answers: bool
    last_acknowledged: int | None
    read_ahead: int
    patience_s: float | None
    on_durable: Callable[[int], None] | None
    on_report: Callable[[StreamRawReport], None] | None = None
    channel: grpc.Channel | None = None


class DeviceStream(Generic[ItemT, RequestT, ResponseT]):
    """The answers to what a device sends, in its order, across breaks of the connection.

    Iterate once. `close` ends the stream early, also from another thread; so do `with` and leaving
    the loop.
    """

    def __init__(
        self,
        call: Callable[[Iterator[RequestT]], Call[ResponseT]],
        cargo: Cargo[ItemT, RequestT, ResponseT],
        items: Iterable[ItemT],
        options: StreamOptions,
    ) -> None:
        self.durable_through: int | None = None
        """Every acknowledged epoch up to this number is durable."""
        self.stored_through: int | None = None
        """That number, or for raw bytes the number of durable bytes."""
        self.breaks = 0
        """Number of streams that ended before everything was answered."""
        self._call = call
        self._cargo = cargo
        self._items = items
        self._options = options
        self._outbox: Outbox[RequestT] = Outbox(options.read_ahead)
        self._closed = threading.Event()
        self._retry = Retry(options.patience_s, options.channel, self._closed)
        self._open: Call[ResponseT] | None = None
        self._fault: BaseException | None = None
        # Numbers of the last epoch that was durable when the first stream opened, and of the last
        # one whose answer the caller has.
        self._durable_before: int | None = None
        self._answered = options.last_acknowledged
        self._answers = self._run()

    def __iter__(self) -> Iterator[Answer]:
        return self._answers

    def __enter__(self) -> DeviceStream[ItemT, RequestT, ResponseT]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends the stream. What is not durable is not sent again."""
        self._closed.set()
        self._outbox.close()
        if self._open is not None:
            self._open.cancel()

    def _run(self) -> Generator[Answer, None, None]:
        threading.Thread(target=self._feed, name="graphfix-feed", daemon=True).start()
        try:
            while not self._closed.is_set():
                if (yield from self._one_stream()):
                    break
        finally:
            self.close()
        if self._fault is not None:
            raise self._fault

    def _feed(self) -> None:
        """Fills the outbox with what the caller gives, in a thread of its own."""
        try:
            self._outbox.fill(self._messages())
        except BaseException as fault:  # Raised again in the caller's thread.
            self._fault = fault
        finally:
            self._outbox.complete()

    def _messages(self) -> Iterator[Message[RequestT]]:
        for item in self._items:
            yield from self._cargo.pack(item)
        yield from self._cargo.end()

    def _one_stream(self) -> Generator[Answer, None, bool]:
        """The answers of one stream. Returns whether everything is answered."""
        link = self._outbox.attach()
        ending: StreamEnding | None = None
        try:
            self._open = self._call(self._requests(link))
            for response in self._open:
                reading = self._cargo.read(response)
                ending = reading.ending or ending
                yield from self._take(reading)
        except grpc.RpcError as error:
            return self._after_break(from_rpc(error), ending)
        finally:
            self._outbox.detach()
        return self._after_end(ending)

    def _requests(self, link: Link) -> Iterator[RequestT]:
        yield self._cargo.opening(self._acknowledged(), self.stored_through)
        yield from self._outbox.messages(link, self._cargo.empty)

    def _acknowledged(self) -> int | None:
        """Number of the last epoch of which nothing is to be sent again."""
        if not self._options.has_answers:
            return self.durable_through
        if self._answered is not None or self._durable_before is None:
            return self._answered
        # No answer has arrived yet: those to the first epochs may have been lost.
        first = self._outbox.first
        return self._durable_before if first is None else min(self._durable_before, first - 1)

    def _take(self, reading: Reading) -> Iterator[Answer]:
        """Takes an answer of the service."""
        dropped = self._outbox.take(reading)
        if dropped or reading.results or self._outbox.is_empty():
            self._retry.reset()
        if self._durable_before is None:
            self._durable_before = reading.durable_through or 0
        self.durable_through = reading.durable_through
        has_risen = (self.stored_through or 0) < reading.stored_through
        self.stored_through = reading.stored_through
        for report in reading.reports:
            if self._options.on_report is not None:
                self._options.on_report(report)
        for result in reading.results:
            answer = self._answer(result)
            if answer is not None:
                yield answer
        if has_risen and self._options.on_durable is not None:
            self._options.on_durable(reading.stored_through)

    def _answer(self, result: StreamResult) -> Answer | None:
        """The answer for the caller; `None` if the caller has it already."""
        if result.HasField("refusal"):
            return Answer(result.seq, refusal=result.refusal)
        if self._answered is not None and result.seq <= self._answered:
            return None
        self._answered = result.seq
        solution = result.solution if result.HasField("solution") else None
        summary = result.summary if result.HasField("summary") else None
        return Answer(result.seq, solution=solution, summary=summary)

    def _after_end(self, ending: StreamEnding | None) -> bool:
        """The service has ended the stream."""
        self._outbox.take_end()
        if self._outbox.is_settled() and ending is None:
            return True
        if self._closed.is_set():
            return True
        if self._outbox.oversized is not None:
            raise GraphfixError(
                "CREDIT_EXCEEDED",
                "a message is larger than the service takes on a stream",
                remedy="send fewer observations, or let the operator raise limits.stream_bytes",
            )
        return self._after_break(unreachable("the service ended the stream"), ending)

    def _after_break(self, error: GraphfixError, ending: StreamEnding | None) -> bool:
        """A stream has ended before its time: waits before the next one."""
        if self._closed.is_set() or (self._outbox.is_settled() and self._has_all_answers()):
            return True
        self.breaks += 1
        if ending is not None:
            self._retry.pause(min(max(ending.retry_after_s, 0.0), 60.0))
        else:
            self._retry.wait(error)
        return False

    def _has_all_answers(self) -> bool:
        durable = self.durable_through or 0
        return not self._options.has_answers or durable <= (self._acknowledged() or 0)
