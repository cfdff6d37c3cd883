"""Attempts that are repeated while a service does not answer."""

from __future__ import annotations

import random
import threading
import time

import grpc

from .errors import GraphfixError

_FIRST_DELAY_S = 0.1
_LONGEST_DELAY_S = 5.0


class Retry:
    """Exponential backoff with jitter, within a patience; the service's own delay comes first."""

    def __init__(
        self,
        patience_s: float | None,
        channel: grpc.Channel | None,
        stopped: threading.Event | None = None,
    ) -> None:
        self._patience_s = patience_s
        self._channel = channel
        self._stopped = stopped or threading.Event()
        self.reset()

    def reset(self) -> None:
        """Begins again, as after an answer."""
        self._since: float | None = None
        self._delay_s = _FIRST_DELAY_S

    def wait(self, error: GraphfixError) -> None:
        """Waits before the next attempt.

        Raises `error` if waiting does not help, or if the patience has ended.
        """
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        is_over = self._patience_s is not None and self._patience_s < now - self._since
        if not error.is_passing or is_over:
            raise error
        delay_s = self._delay_s * random.uniform(0.5, 1.0)
        self.pause(delay_s if error.retry_after_s is None else error.retry_after_s)
        self._delay_s = min(2 * self._delay_s, _LONGEST_DELAY_S)

    def pause(self, delay_s: float) -> None:
        """Waits for a time (s), or until the caller stops."""
        if self._channel is None:
            self._stopped.wait(delay_s)
            return
        # gRPC connects only while somebody waits for the channel.
        self._channel.subscribe(_ignore, try_to_connect=True)
        self._stopped.wait(delay_s)
        self._channel.unsubscribe(_ignore)


def _ignore(state: grpc.ChannelConnectivity) -> None:
    """Takes no notice of a channel's state."""
