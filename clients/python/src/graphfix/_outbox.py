"""What a device has to send: kept until it is durable, sent within the credit.

Three threads meet here. One fills the outbox from what the caller gives, one sends it on the open
stream, and the caller's own thread takes out what has become durable.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

from ._cargo import Amount, Message, Reading

# Part of the service's patience after which a silent device sends a message without content.
_KEEP_OPEN = 0.3

RequestT = TypeVar("RequestT")


class Link:
    """The sending side of one stream."""

    def __init__(self) -> None:
        self.is_open = True
        # Unknown until the service has answered the opening.
        self.credit: Amount | None = None
        self.window = Amount()
        self.sent = Amount()
        self.idle_s = 60.0
        self.last_sent = time.monotonic()

    def silent_for_s(self) -> float:
        """Time until a message without content is due (s)."""
        return self.last_sent + _KEEP_OPEN * self.idle_s - time.monotonic()


class Outbox(Generic[RequestT]):
    """The messages of one session that are not durable yet, in the order in which they are sent."""

    def __init__(self, read_ahead: int) -> None:
        self._read_ahead = read_ahead
        self._changed = threading.Condition()
        self._kept: deque[Message[RequestT]] = deque()
        # Number of kept messages that the open stream has carried.
        self._carried = 0
        self._link: Link | None = None
        self._is_complete = False
        self._is_closed = False
        # A message that exceeds the credit of a new stream, so that it can never be sent.
        self.oversized: Message[RequestT] | None = None
        # Number of the first message that was ever given.
        self.first: int | None = None

    def fill(self, messages: Iterable[Message[RequestT]]) -> None:
        """Takes messages while there is room, until all are taken or the outbox is closed."""
        for message in messages:
            with self._changed:
                self._changed.wait_for(lambda: self._is_closed or self._has_room())
                if self._is_closed:
                    return
                self.first = message.through if self.first is None else self.first
                self._kept.append(message)
                self._changed.notify_all()

    def complete(self) -> None:
        """Nothing more will be given."""
        with self._changed:
            self._is_complete = True
            self._changed.notify_all()

    def close(self) -> None:
        """Ends the threads that fill and send."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def attach(self) -> Link:
        """Begins a stream, which carries all kept messages again."""
        with self._changed:
            self._carried = 0
            self._link = Link()
            return self._link

    def detach(self) -> None:
        """Ends the sending side of the stream."""
        with self._changed:
            if self._link is not None:
                self._link.is_open = False
            self._changed.notify_all()

    def is_settled(self) -> bool:
        """Whether everything is given, and durable."""
        with self._changed:
            return self._is_complete and not self._kept

    def is_empty(self) -> bool:
        """Whether everything that was given is durable."""
        with self._changed:
            return not self._kept

    def messages(self, link: Link, empty: Callable[[], RequestT]) -> Iterator[RequestT]:
        """The messages after the opening of a stream, each as soon as the credit allows it."""
        while True:
            with self._changed:
                while (message := self._next(link, empty)) is None:
                    if self._is_over(link):
                        return
                    self._changed.wait(None if link.credit is None else link.silent_for_s())
            yield message

    def take(self, reading: Reading) -> int:
        """Drops what is durable or refused, and raises the credit; returns how many messages."""
        refused = {result.seq for result in reading.results if result.HasField("refusal")}
        with self._changed:
            link = self._link
            if link is None:
                return 0
            before = len(self._kept)
            is_first = link.credit is None
            while self._kept and self._is_done(is_first, reading.stored_through, refused):
                self._kept.popleft()
                self._carried = max(0, self._carried - 1)
            link.credit = reading.credit
            if is_first:
                link.window = reading.credit
                link.idle_s = min(max(reading.idle_s or link.idle_s, 0.1), 86_400.0)
            if reading.ending is not None:
                link.is_open = False
            self._changed.notify_all()
            return before - len(self._kept)

    def take_end(self) -> None:
        """Drops the end of a receiver's stream, if the stream that has just ended carried it.

        The service ends a stream without an error only after it has answered everything.
        """
        with self._changed:
            is_carried = 0 < self._carried == len(self._kept)
            if is_carried and not any(message.has_content for message in self._kept):
                self._kept.clear()
                self._carried = 0

    def _is_done(self, is_first: bool, stored_through: int, refused: set[int]) -> bool:
        message = self._kept[0]
        if not message.has_content:
            # The answer to the last bytes has the same number.
            return False
        if is_first:
            # A message that was never sent is not dropped: if its number is stored already, the
            # service compares the content.
            return message.was_sent and message.through <= stored_through
        was_carried = 0 < self._carried
        return was_carried and (message.through <= stored_through or message.through in refused)

    def _has_room(self) -> bool:
        return len(self._kept) - self._carried < self._read_ahead

    def _next(self, link: Link, empty: Callable[[], RequestT]) -> RequestT | None:
        """The next message, if one may be sent now."""
        if not link.is_open or self._is_closed or link.credit is None:
            return None
        if self._carried < len(self._kept):
            message = self._kept[self._carried]
            sent = link.sent.plus(message.amount)
            if sent.is_within(link.credit):
                link.sent, link.last_sent = sent, time.monotonic()
                self._carried += 1
                message.was_sent = True
                self._changed.notify_all()
                return message.request
            if not message.amount.is_within(link.window):
                self.oversized = message
        if link.silent_for_s() <= 0:
            link.last_sent = time.monotonic()
            return empty()
        return None

    def _is_over(self, link: Link) -> bool:
        """Whether the sending side of a stream has ended."""
        if not link.is_open or self._is_closed:
            return True
        if link.credit is None:
            return False
        has_sent_all = self._carried == len(self._kept)
        is_stuck = self.oversized is not None and self._carried == 0
        return (self._is_complete and has_sent_all) or is_stuck
