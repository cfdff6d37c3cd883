"""A session of one rover: what it sends, and what is stored of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Literal

import grpc

from ._calls import Calls
from ._cargo import Epochs, RawBytes
from ._device_stream import Answer, DeviceStream, StreamOptions
from ._watch import watch
from .errors import from_rpc
from .v1.observation_pb2 import Epoch, GpsTime
from .v1.positioning_pb2 import (
    ANSWERS_FULL,
    ANSWERS_NONE,
    ANSWERS_SUMMARY,
    PushEpochsRequest,
    PushEpochsResponse,
    PushRawRequest,
    PushRawResponse,
    SolveRequest,
    SolveResponse,
    StreamRawReport,
    StreamRawRequest,
    StreamRawResponse,
    StreamRequest,
    StreamResponse,
)
from .v1.sessions_pb2 import (
    CloseSessionRequest,
    DeleteSessionRequest,
    GetSessionRequest,
    ResetSessionRequest,
    UpdateSessionRequest,
)
from .v1.sessions_pb2 import Session as SessionInfo
from .v1.solution_pb2 import Solution, Status
from .v1.solutions_pb2 import (
    REVISIONS_ALL,
    REVISIONS_FIRST,
    REVISIONS_LAST,
    ListSolutionsRequest,
    ListSolutionsResponse,
    TrackRequest,
    TrackResponse,
    WatchSolutionsResponse,
)

AnswerKind = Literal["none", "summary", "full"]
RevisionKind = Literal["last", "first", "all"]

_ANSWERS = {"none": ANSWERS_NONE, "summary": ANSWERS_SUMMARY, "full": ANSWERS_FULL}
_REVISIONS = {"last": REVISIONS_LAST, "first": REVISIONS_FIRST, "all": REVISIONS_ALL}
_PAGE = 1000


class Session:
    """A session; `Client.create_session` and `Client.session` return it."""

    def __init__(self, calls: Calls, info: SessionInfo) -> None:
        self._calls = calls
        self.info = info
        """The session as the service last described it; see `refresh`."""

    @property
    def id(self) -> str:
        """Id of the session, such as `ses_…`."""
        return self.info.session

    @property
    def durable_through(self) -> int | None:
        """Number of the last epoch that was stored when `info` was asked for; `None` before one."""
        return self.info.durable_through if self.info.HasField("durable_through") else None

    @property
    def raw_through(self) -> int:
        """Number of raw bytes that were stored when `info` was asked for."""
        return self.info.raw_through

    def refresh(self) -> SessionInfo:
        """Asks for the session again."""
        request = GetSessionRequest(session=self.id)
        return self._changed(self._calls.sessions.Get, request)

    def stream(
        self,
        epochs: Iterable[Epoch],
        *,
        answers: AnswerKind = "full",
        last_acknowledged: int | None = None,
        read_ahead: int = 8,
        patience_s: float | None = None,
        on_durable: Callable[[int], None] | None = None,
    ) -> DeviceStream[Epoch, StreamRequest, StreamResponse]:
        """Sends epochs as they come, and gives the answer to each, in their order.

        The cheapest way for a device. Epochs are numbered by `seq`, rising. `epochs` is read in a
        thread of its own and may block, as a receiver does. After a break of the connection or a
        restart of the service the stream goes on by itself: each epoch is stored once and answered
        once. An epoch that is stored already gets its stored answer; other content under its number
        is refused.

        Only as many epochs are in memory as the service gives credit for, and `read_ahead` more:
        while the service does not answer, or the caller does not take answers, `epochs` is not read
        on. A receiver that cannot wait needs a `read_ahead` as long as the longest interruption.

        - `answers`: `full`, `summary` (status, position, standard deviations), or `none`, which
          gives refusals only.
        - `last_acknowledged`: number of the last epoch whose answer an earlier stream has given.
          The answers to stored epochs after it come first. The service refuses a number that it has
          never acknowledged (`ACKNOWLEDGEMENT_UNKNOWN`).
        - `patience_s`: how long to try to reach a service that does not answer (s); by default that
          of the client.
        - `on_durable`: called with a number when all acknowledged epochs up to it are stored, so
          that the device may delete them.

        A refusal of one epoch is an answer. Iterating raises `GraphfixError` if the service refuses
        the stream or does not answer again, and what `epochs` raises, after the answers to the
        epochs before.
        """
        cargo = Epochs(self.id, _ANSWERS[answers])
        options = StreamOptions(
            has_answers=answers != "none",
            last_acknowledged=last_acknowledged,
            read_ahead=read_ahead,
            patience_s=self._calls.patience_s if patience_s is None else patience_s,
            on_durable=on_durable,
            channel=self._calls.channel,
        )
        call = self._calls.stream(self._calls.positioning.Stream, self.id)
        return DeviceStream(call, cargo, epochs, options)

    def stream_raw(
        self,
        chunks: Iterable[bytes],
        *,
        offset: int | None = None,
        end: bool = False,
        near: GpsTime | None = None,
        answers: AnswerKind = "full",
        last_acknowledged: int | None = None,
        read_ahead: int = 8,
        patience_s: float | None = None,
        on_durable: Callable[[int], None] | None = None,
        on_report: Callable[[StreamRawReport], None] | None = None,
    ) -> DeviceStream[bytes, StreamRawRequest, StreamRawResponse]:
        """Sends the bytes of a receiver as they come, and gives the answers to their epochs.

        The bytes are RTCM 3, UBX, RINEX observations, CRINEX or an Android GnssLogger log, plain or
        packed by gzip, split anywhere; the service decodes them and numbers the epochs. All that
        `stream` says of breaks and memory holds for bytes.

        - `offset`: number of bytes sent to the session before the first chunk. By default
          `raw_through` at present: a receiver goes on, whatever was lost while nobody listened. A
          file is read from there.
        - `end`: the stream of the receiver ends with the last chunk, as that of a file does.
        - `near`: a time within half a day of the first message, for recorded RTCM 3. By default the
          service's clock.
        - `on_durable`: called with a number of bytes when all up to it are stored.
        - `on_report`: called with what each chunk contained: format, messages, what was left out.
        """
        offset = self.refresh().raw_through if offset is None else offset
        cargo = RawBytes(self.id, _ANSWERS[answers], offset=offset, near=near, has_end=end)
        options = StreamOptions(
            has_answers=answers != "none",
            last_acknowledged=last_acknowledged,
            read_ahead=read_ahead,
            patience_s=self._calls.patience_s if patience_s is None else patience_s,
            on_durable=on_durable,
            on_report=on_report,
            channel=self._calls.channel,
        )
        call = self._calls.stream(self._calls.positioning.StreamRaw, self.id)
        return DeviceStream(call, cargo, chunks, options)

    def push(self, epochs: Sequence[Epoch]) -> PushEpochsResponse:
        """Positions a few epochs in one call; for many, `stream` is cheaper."""
        request = PushEpochsRequest(session=self.id, epochs=epochs)
        method = self._calls.positioning.PushEpochs
        return self._calls.once(method, request, PushEpochsResponse, session=self.id)

    def push_raw(
        self, content: bytes, *, offset: int, end: bool = False, near: GpsTime | None = None
    ) -> PushRawResponse:
        """Sends bytes of a receiver in one call; see `stream_raw`."""
        request = PushRawRequest(
            session=self.id, offset=offset, content=content, end=end, near=near
        )
        method = self._calls.positioning.PushRaw
        return self._calls.once(method, request, PushRawResponse, session=self.id)

    def solve(
        self,
        *,
        mode: str = "",
        profile: str = "",
        overrides: Mapping[str, str] | None = None,
        base: str = "",
        bases: Sequence[str] = (),
    ) -> Solution:
        """Solves the present window with other options; the session is not affected."""
        request = SolveRequest(
            session=self.id,
            mode=mode,
            profile=profile,
            overrides=overrides,
            base=base,
            bases=bases,
        )
        method = self._calls.positioning.Solve
        return self._calls.once(method, request, SolveResponse, session=self.id).solution

    def solutions(
        self,
        *,
        start: GpsTime | None = None,
        end: GpsTime | None = None,
        status: Status | None = None,
        revisions: RevisionKind = "last",
        page_size: int = _PAGE,
    ) -> Iterator[Solution]:
        """The stored solutions in order of number and revision, one page in memory at a time.

        `start` and `end` are the first and last time tag (GPS time). Revision 0 is the immediate
        answer, revision 1 the smoothed one: `last` gives the newest of each epoch.
        """

        def request(token: str) -> ListSolutionsRequest:
            request = ListSolutionsRequest(
                session=self.id,
                to=end,
                status=status,
                page_size=page_size,
                page_token=token,
                revisions=_REVISIONS[revisions],
            )
            if start is not None:
                # `from` is a keyword of Python.
                getattr(request, "from").CopyFrom(start)
            return request

        method = self._calls.solutions.List
        pages = self._calls.pages(method, request, ListSolutionsResponse, session=self.id)
        return (solution for page in pages for solution in page.solutions)

    def watch(
        self,
        *,
        cursor: str = "",
        after_seq: int | None = None,
        revisions: Literal["first", "all"] = "all",
    ) -> Iterator[WatchSolutionsResponse]:
        """The solutions as they are committed, until the session is closed.

        Each message has `solutions` and the `cursor` behind them. Store the cursor, and give it to
        the next watch after a restart: it goes on there and misses nothing. Without a cursor the
        watch begins with the epochs after `after_seq` (0 for all), or with what is committed from
        now on. It goes on by itself after a break. A slow reader is disconnected and goes on
        too, so nothing piles up in memory.
        """
        return watch(
            self._calls, self.id, cursor=cursor, after=after_seq, revisions=_REVISIONS[revisions]
        )

    def track(self, format: str, *, revisions: RevisionKind = "last") -> Iterator[bytes]:
        """The stored solutions as a file: `pos`, `csv`, `geojson`, `kml`, `gpx` or `nmea`.

        The file is complete if the iteration ends without an exception.
        """
        request = TrackRequest(session=self.id, format=format, revisions=_REVISIONS[revisions])
        try:
            for part in self._calls.answers(self._calls.solutions.Track, request, self.id):
                assert isinstance(part, TrackResponse)
                yield part.content
        except grpc.RpcError as error:
            raise from_rpc(error) from error

    def update(self, request: UpdateSessionRequest) -> SessionInfo:
        """Changes the fields that `request` has, and no others."""
        own = UpdateSessionRequest()
        own.CopyFrom(request)
        own.session = self.id
        return self._changed(self._calls.sessions.Update, own)

    def close(self) -> SessionInfo:
        """Closes the session: it takes no more epochs, and its solutions stay."""
        return self._changed(self._calls.sessions.Close, CloseSessionRequest(session=self.id))

    def reset(self) -> SessionInfo:
        """Begins a new arc: the next epoch may be earlier, and its estimator starts again."""
        request = ResetSessionRequest(session=self.id)
        return self._changed(self._calls.sessions.Reset, request, is_repeatable=False)

    def delete(self) -> SessionInfo:
        """Deletes the session with all that is stored of it."""
        request = DeleteSessionRequest(session=self.id)
        return self._changed(self._calls.sessions.Delete, request, is_repeatable=False)

    def _changed(
        self, method: object, request: object, *, is_repeatable: bool = True
    ) -> SessionInfo:
        self.info = self._calls.once(
            method, request, SessionInfo, session=self.id, is_repeatable=is_repeatable
        )
        return self.info


__all__ = ["Answer", "AnswerKind", "RevisionKind", "Session"]
