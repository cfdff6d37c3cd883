"""A watch of stored solutions that goes on behind its cursor."""

from __future__ import annotations

from collections.abc import Iterator

import grpc

from ._calls import Calls
from ._retry import Retry
from .errors import from_rpc, unreachable
from .v1.solutions_pb2 import Revisions, WatchSolutionsRequest, WatchSolutionsResponse


def watch(
    calls: Calls, session: str, *, cursor: str, after: int | None, revisions: Revisions
) -> Iterator[WatchSolutionsResponse]:
    """The messages with solutions, and the last one of a closed session."""
    retry = Retry(calls.patience_s, calls.channel)
    while True:
        request = WatchSolutionsRequest(
            session=session,
            revisions=revisions,
            cursor=cursor,
            after_seq=None if cursor else after,
        )
        try:
            for message in calls.answers(calls.solutions.Watch, request, session):
                assert isinstance(message, WatchSolutionsResponse)
                retry.reset()
                cursor = message.cursor or cursor
                if message.solutions or message.closed:
                    yield message
                if message.closed:
                    return
        except grpc.RpcError as error:
            retry.wait(from_rpc(error))
        else:
            retry.wait(unreachable("the service ended the watch"))
