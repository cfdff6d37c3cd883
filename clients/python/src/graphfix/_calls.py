"""The connection to a service, and its calls with their types."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import grpc

from ._retry import Retry
from .errors import from_rpc, unreachable
from .v1 import (
    bases_pb2_grpc,
    navigation_pb2_grpc,
    positioning_pb2_grpc,
    sessions_pb2_grpc,
    solutions_pb2_grpc,
)

RequestT = TypeVar("RequestT")
ResponseT = TypeVar("ResponseT")

# A service that answers no ping within these times is taken for gone. A page of 10 000 solutions
# has some 20 MB.
_CHANNEL = [
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 5_000),
    ("grpc.max_reconnect_backoff_ms", 2_000),
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.max_receive_message_length", 64 << 20),
    ("grpc.max_send_message_length", 64 << 20),
]
_SESSION = "x-graphfix-session"


@dataclass(frozen=True)
class Tls:
    """Files in PEM; without `ca`, the authorities that gRPC brings."""

    ca: Path | None = None
    certificate: Path | None = None
    private_key: Path | None = None

    def credentials(self) -> grpc.ChannelCredentials:
        """The files as gRPC takes them."""
        files = (self.ca, self.private_key, self.certificate)
        contents = [None if file is None else file.read_bytes() for file in files]
        return grpc.ssl_channel_credentials(*contents)


class Calls:
    """The calls of one service, over one connection."""

    def __init__(
        self,
        url: str,
        *,
        key: str | None,
        tls: Tls,
        timeout_s: float,
        patience_s: float | None,
    ) -> None:
        self.patience_s = patience_s
        self._timeout_s = timeout_s
        self._key = key
        self.channel = _channel(url, key, tls)
        self.sessions: Any = sessions_pb2_grpc.SessionsStub(self.channel)
        self.positioning: Any = positioning_pb2_grpc.PositioningStub(self.channel)
        self.solutions: Any = solutions_pb2_grpc.SolutionsStub(self.channel)
        self.navigation: Any = navigation_pb2_grpc.NavigationStub(self.channel)
        self.bases: Any = bases_pb2_grpc.BasesStub(self.channel)

    def once(
        self,
        method: Any,
        request: object,
        answer: type[ResponseT],
        *,
        session: str | None = None,
        is_repeatable: bool = True,
    ) -> ResponseT:
        """One call, repeated while the service does not answer or asks to wait.

        A call that is not repeatable, such as a create, is repeated only if the service has refused
        it: after a break nobody knows whether it took effect.
        """
        if not is_repeatable:
            self._until_connected()
        retry = Retry(self.patience_s, self.channel)
        while True:
            try:
                metadata = self.metadata(session)
                response = method(request, timeout=self._timeout_s, metadata=metadata)
            except grpc.RpcError as error:
                refusal = from_rpc(error)
                if not is_repeatable and refusal.retry_after_s is None:
                    raise refusal from error
                retry.wait(refusal)
                continue
            if not isinstance(response, answer):
                raise TypeError(f"{type(response)} in place of {answer}")
            return response

    def pages(
        self,
        method: Any,
        request: Callable[[str], object],
        answer: type[ResponseT],
        *,
        session: str | None = None,
    ) -> Iterator[ResponseT]:
        """All pages of a list; `request` takes the token of a page, empty for the first."""
        token = ""
        while True:
            page = self.once(method, request(token), answer, session=session)
            yield page
            token = getattr(page, "next_page_token")  # noqa: B009 (lists alone have it)
            if not token:
                return

    def _until_connected(self) -> None:
        """Waits for the service, so that a call that takes effect once is not lost on the way."""
        try:
            grpc.channel_ready_future(self.channel).result(timeout=self.patience_s)
        except grpc.FutureTimeoutError as error:
            raise unreachable("no connection within the client's patience") from error

    def stream(self, method: Any, session: str) -> Callable[[Iterator[RequestT]], Any]:
        """Opens streams of a session in both directions."""
        return lambda requests: method(requests, metadata=self.metadata(session))

    def answers(self, method: Any, request: object, session: str) -> Iterator[object]:
        """The answers of a call that has many; the call is cancelled if they are not all read."""
        call = method(request, metadata=self.metadata(session))
        try:
            yield from call
        finally:
            call.cancel()

    def metadata(self, session: str | None) -> list[tuple[str, str]]:
        """The key, and the session by which a balancer chooses a node."""
        metadata = [] if session is None else [(_SESSION, session)]
        if self._key is not None:
            metadata.append(("authorization", f"Bearer {self._key}"))
        return metadata


def _channel(url: str, key: str | None, tls: Tls) -> grpc.Channel:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or parts.hostname is None or parts.path.strip("/"):
        raise ValueError(f"{url!r} is not the address of a service, such as http://127.0.0.1:8080")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    target = f"{host}:{parts.port or (443 if parts.scheme == 'https' else 80)}"
    if parts.scheme == "https":
        return grpc.secure_channel(target, tls.credentials(), options=_CHANNEL)
    if key is not None and parts.hostname not in ("127.0.0.1", "::1", "localhost"):
        raise ValueError(f"{url!r} would send the key without encryption: use https://")
    return grpc.insecure_channel(target, options=_CHANNEL)
