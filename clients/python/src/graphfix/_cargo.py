"""What a stream of a device carries: numbered epochs, or the bytes of a receiver."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from .v1.observation_pb2 import Epoch, GpsTime
from .v1.positioning_pb2 import (
    Answers,
    StreamEnding,
    StreamOpening,
    StreamRawOpening,
    StreamRawReport,
    StreamRawRequest,
    StreamRawResponse,
    StreamRequest,
    StreamResponse,
    StreamResult,
)

# Larger chunks are split, so that a stream's credit holds several of them.
_CHUNK_BYTES = 64 << 10

ItemT = TypeVar("ItemT", contravariant=True)
RequestT = TypeVar("RequestT")
ResponseT = TypeVar("ResponseT", contravariant=True)


@dataclass(frozen=True)
class Amount:
    """Epochs or chunks, and the bytes of their messages."""

    count: int = 0
    bytes: int = 0

    def plus(self, other: Amount) -> Amount:
        """Both together."""
        return Amount(self.count + other.count, self.bytes + other.bytes)

    def is_within(self, credit: Amount) -> bool:
        """Whether both numbers are at most those of `credit`."""
        return self.count <= credit.count and self.bytes <= credit.bytes


@dataclass
class Message(Generic[RequestT]):
    """A message that is not durable yet."""

    request: RequestT
    amount: Amount
    # It is durable once the service has stored epochs, or bytes, up to this number.
    through: int
    # Not so the end of a receiver's stream: the service may have all bytes without knowing that
    # they are all. It is done when the service ends a stream that has carried it.
    has_content: bool = True
    was_sent: bool = False


@dataclass(frozen=True)
class Reading:
    """The content of an answer, to epochs and to bytes alike."""

    # Time without a message after which the service ends the stream (s); in the first answer.
    idle_s: float | None
    # Number of the last durable epoch.
    durable_through: int | None
    # What messages are compared with: that number, or the number of durable bytes.
    stored_through: int
    credit: Amount
    results: list[StreamResult]
    ending: StreamEnding | None
    reports: list[StreamRawReport] = field(default_factory=list)


class Cargo(Protocol[ItemT, RequestT, ResponseT]):
    """A kind of stream."""

    def opening(self, acknowledged: int | None, stored: int | None) -> RequestT:
        """The first message."""

    def pack(self, item: ItemT) -> Iterator[Message[RequestT]]:
        """The messages of what the device sends."""

    def end(self) -> Iterator[Message[RequestT]]:
        """The messages after the last one."""

    def empty(self) -> RequestT:
        """A message without content, which keeps a silent stream open."""

    def read(self, response: ResponseT) -> Reading:
        """The content of an answer."""


class Epochs:
    """Epochs with the device's numbers."""

    def __init__(self, session: str, answers: Answers) -> None:
        self._session = session
        self._answers = answers

    def opening(self, acknowledged: int | None, stored: int | None) -> StreamRequest:
        """As `Cargo.opening`."""
        opening = StreamOpening(
            session=self._session, last_acknowledged=acknowledged, answers=self._answers
        )
        return StreamRequest(opening=opening)

    def pack(self, item: Epoch) -> Iterator[Message[StreamRequest]]:
        """One message for each epoch, so that a wrong one is refused alone."""
        request = StreamRequest(epochs=[item])
        yield Message(request, Amount(1, request.ByteSize()), item.seq)

    def end(self) -> Iterator[Message[StreamRequest]]:
        """None."""
        return iter(())

    def empty(self) -> StreamRequest:
        """As `Cargo.empty`."""
        return StreamRequest()

    def read(self, response: StreamResponse) -> Reading:
        """As `Cargo.read`."""
        durable = response.durable_through if response.HasField("durable_through") else None
        return Reading(
            idle_s=response.opened.idle_s if response.HasField("opened") else None,
            durable_through=durable,
            stored_through=durable or 0,
            credit=Amount(response.credit.epochs, response.credit.bytes),
            results=list(response.results),
            ending=response.ending if response.HasField("ending") else None,
        )


class RawBytes:
    """The bytes of a receiver, counted from the first one of the session."""

    def __init__(
        self,
        session: str,
        answers: Answers,
        *,
        offset: int,
        near: GpsTime | None,
        has_end: bool,
    ) -> None:
        self._session = session
        self._answers = answers
        self._offset = offset
        self._near = near
        self._has_end = has_end

    def opening(self, acknowledged: int | None, stored: int | None) -> StreamRawRequest:
        """As `Cargo.opening`."""
        opening = StreamRawOpening(
            session=self._session,
            last_acknowledged=acknowledged,
            raw_acknowledged=stored,
            answers=self._answers,
            near=self._near,
        )
        return StreamRawRequest(opening=opening)

    def pack(self, item: bytes) -> Iterator[Message[StreamRawRequest]]:
        """The bytes in chunks."""
        for start in range(0, len(item), _CHUNK_BYTES):
            yield self._chunk(item[start : start + _CHUNK_BYTES])

    def end(self) -> Iterator[Message[StreamRawRequest]]:
        """A message without bytes that ends the receiver's stream."""
        if self._has_end:
            yield self._chunk(b"", end=True)

    def empty(self) -> StreamRawRequest:
        """As `Cargo.empty`."""
        return StreamRawRequest()

    def read(self, response: StreamRawResponse) -> Reading:
        """As `Cargo.read`."""
        durable = response.durable_through if response.HasField("durable_through") else None
        return Reading(
            idle_s=response.opened.idle_s if response.HasField("opened") else None,
            durable_through=durable,
            stored_through=response.raw_through,
            credit=Amount(response.credit.chunks, response.credit.bytes),
            results=list(response.results),
            ending=response.ending if response.HasField("ending") else None,
            reports=list(response.reports),
        )

    def _chunk(self, content: bytes, *, end: bool = False) -> Message[StreamRawRequest]:
        request = StreamRawRequest(offset=self._offset, content=content, end=end)
        self._offset += len(content)
        amount = Amount(1, request.ByteSize())
        return Message(request, amount, self._offset, has_content=bool(content))
