"""A service, its sessions, bases and ephemerides."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from uuid import uuid4

from ._calls import Calls, Tls
from .session import Session
from .v1.bases_pb2 import (
    Base,
    CreateBaseRequest,
    DeleteBaseRequest,
    DeleteBaseResponse,
    GetBaseRequest,
    ListBasesRequest,
    ListBasesResponse,
    PushBaseEpochsRequest,
    PushBaseEpochsResponse,
    UploadBaseRequest,
    UploadBaseResponse,
)
from .v1.navigation_pb2 import (
    NavigationStatusRequest,
    NavigationStatusResponse,
    PushNavigationRequest,
    PushNavigationResponse,
)
from .v1.observation_pb2 import Epoch
from .v1.positioning_pb2 import SolveOnceRequest, SolveOnceResponse
from .v1.sessions_pb2 import (
    CreateSessionRequest,
    GetSessionRequest,
    ListHeadsRequest,
    ListHeadsResponse,
    ListSessionsRequest,
    ListSessionsResponse,
    SessionHead,
)
from .v1.sessions_pb2 import Session as SessionInfo
from .v1.solution_pb2 import Solution

PathLike = str | os.PathLike[str]


class Client:
    """A connection to a service, for any number of threads and sessions.

    - `url`: address of the service, such as `http://127.0.0.1:8080` or `https://gnss.example.org`.
    - `key`: API key. It is sent over TLS, or to this machine, only.
    - `ca_file`, `certificate_file`, `private_key_file`: PEM files: the authority that has signed
      the service's certificate (by default those that gRPC brings), and the client's own
      certificate where the service asks for one.
    - `timeout_s`: longest time for the answer to one call (s). Streams and watches have none.
    - `patience_s`: how long to try again while the service does not answer or asks to wait (s);
      `None` for ever, as an unattended device does.

    Calls raise `GraphfixError`.
    """

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        ca_file: PathLike | None = None,
        certificate_file: PathLike | None = None,
        private_key_file: PathLike | None = None,
        timeout_s: float = 60.0,
        patience_s: float | None = 60.0,
    ) -> None:
        files = (ca_file, certificate_file, private_key_file)
        tls = Tls(*(None if file is None else Path(file) for file in files))
        self._calls = Calls(url, key=key, tls=tls, timeout_s=timeout_s, patience_s=patience_s)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection; its streams and watches end."""
        self._calls.channel.close()

    # Sessions

    def create_session(
        self,
        *,
        mode: str = "",
        profile: str = "",
        overrides: Mapping[str, str] | None = None,
        base: str = "",
        bases: Sequence[str] = (),
        antenna: str = "",
        label: str = "",
        retention_days: int | None = None,
    ) -> Session:
        """Opens a session of a rover.

        - `mode`: `spp` (the default), `ekf`, `fgo`, `rtk-ekf` or `rtk-fgo`.
        - `profile`: a set of default options: `general` (the default), `urban-vehicle`, `static`,
          `phone` or `paper`. `overrides` changes single options, by key.
        - `base`: id of a base for a mode relative to one, or `nearest`; `bases`: several, of which
          the nearest is used.
        - `antenna`: type and radome of the rover's antenna, as the IGS names them.
        - `label`: a name for people.
        - `retention_days`: for how long epochs and solutions are kept (days); 0 for ever. By
          default as the operator has configured.
        """
        request = CreateSessionRequest(
            label=label,
            mode=mode,
            profile=profile,
            overrides=overrides,
            base=base,
            bases=bases,
            antenna=antenna,
            retention_days=retention_days,
            request_id=str(uuid4()),
        )
        info = self._calls.once(self._calls.sessions.Create, request, SessionInfo)
        return Session(self._calls, info)

    def session(self, session: str) -> Session:
        """An existing session."""
        request = GetSessionRequest(session=session)
        info = self._calls.once(self._calls.sessions.Get, request, SessionInfo, session=session)
        return Session(self._calls, info)

    def sessions(self, *, page_size: int = 100) -> Iterator[SessionInfo]:
        """All sessions with their configurations, the newest first."""

        def request(token: str) -> ListSessionsRequest:
            return ListSessionsRequest(page_size=page_size, page_token=token)

        pages = self._calls.pages(self._calls.sessions.List, request, ListSessionsResponse)
        return (item for page in pages for item in page.sessions)

    def heads(self, *, page_size: int = 1000) -> Iterator[SessionHead]:
        """Latest status and position of all sessions, the newest first: a fleet at a glance.

        Positions are latitude and longitude (degrees) and height above the ellipsoid (m).
        """

        def request(token: str) -> ListHeadsRequest:
            return ListHeadsRequest(page_size=page_size, page_token=token)

        pages = self._calls.pages(self._calls.sessions.Heads, request, ListHeadsResponse)
        return (item for page in pages for item in page.heads)

    def solve_once(self, request: SolveOnceRequest) -> Sequence[Solution]:
        """Positions one or a few epochs without a session; nothing is stored."""
        method = self._calls.positioning.SolveOnce
        return self._calls.once(method, request, SolveOnceResponse).solutions

    # Ephemerides

    def push_navigation(self, content: bytes) -> PushNavigationResponse:
        """Uploads a RINEX navigation file, plain or gzip, for all sessions."""
        request = PushNavigationRequest(content=content)
        return self._calls.once(self._calls.navigation.Push, request, PushNavigationResponse)

    def navigation_status(self) -> NavigationStatusResponse:
        """The satellites with ephemerides, the time that these cover, and their sources."""
        request = NavigationStatusRequest()
        return self._calls.once(self._calls.navigation.Status, request, NavigationStatusResponse)

    # Bases

    def create_base(self, request: CreateBaseRequest | None = None) -> Base:
        """Creates a base station; without position, it takes that of the first file."""
        named = CreateBaseRequest(request_id=str(uuid4()))
        if request is not None:
            named.MergeFrom(request)
        return self._calls.once(self._calls.bases.Create, named, Base)

    def base(self, base: str) -> Base:
        """A base with its health."""
        return self._calls.once(self._calls.bases.Get, GetBaseRequest(base=base), Base)

    def bases(self, *, page_size: int = 100) -> Iterator[Base]:
        """All bases with their health, in order of id."""

        def request(token: str) -> ListBasesRequest:
            return ListBasesRequest(page_size=page_size, page_token=token)

        pages = self._calls.pages(self._calls.bases.List, request, ListBasesResponse)
        return (item for page in pages for item in page.bases)

    def upload_base(self, base: str, content: bytes) -> UploadBaseResponse:
        """Uploads a RINEX observation file of a base, plain or gzip."""
        request = UploadBaseRequest(base=base, content=content)
        return self._calls.once(self._calls.bases.Upload, request, UploadBaseResponse)

    def push_base_epochs(self, base: str, epochs: Sequence[Epoch]) -> PushBaseEpochsResponse:
        """Sends epochs of a base in order of time."""
        request = PushBaseEpochsRequest(base=base, epochs=epochs)
        return self._calls.once(self._calls.bases.PushEpochs, request, PushBaseEpochsResponse)

    def delete_base(self, base: str) -> None:
        """Deletes a base with its epochs, unless an open session uses it."""
        request = DeleteBaseRequest(base=base)
        method = self._calls.bases.Delete
        self._calls.once(method, request, DeleteBaseResponse, is_repeatable=False)
