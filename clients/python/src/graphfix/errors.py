"""Refusals of the service as exceptions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import grpc
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2
from grpc_status import rpc_status

_DOMAIN = "graphfix"
# A connection that breaks is reported with one of these.
_BREAKS = {
    grpc.StatusCode.CANCELLED,
    grpc.StatusCode.DEADLINE_EXCEEDED,
    grpc.StatusCode.UNAVAILABLE,
    grpc.StatusCode.UNKNOWN,
}


class GraphfixError(Exception):
    """A call was refused, or not answered.

    `code` is stable (docs/errors.md); do not compare messages. `field` is the path of the value at
    fault, such as `epochs[3].time`; `remedy` says what to do. `is_passing` says whether
    the same call may succeed later, `retry_after_s` after which delay (s).
    """

    def __init__(
        self,
        code: str,
        message: str,
        *,
        remedy: str = "",
        field: str | None = None,
        retry_after_s: float | None = None,
        byte_offset: int | None = None,
        line: int | None = None,
        is_passing: bool = False,
    ) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.remedy = remedy
        self.field = field
        self.retry_after_s = retry_after_s
        self.byte_offset = byte_offset
        self.line = line
        self.is_passing = is_passing or retry_after_s is not None

    def __str__(self) -> str:
        field = f"{self.field}: " if self.field else ""
        remedy = f" ({self.remedy})" if self.remedy else ""
        return f"{self.code}: {field}{self.message}{remedy}"


class ServiceUnreachableError(GraphfixError):
    """The service does not answer, or the connection broke before its answer."""


def from_rpc(error: grpc.RpcError) -> GraphfixError:
    """The refusal that a failed call carries."""
    call = cast(grpc.Call, error)
    message = call.details() or ""
    details = _details(call)
    if details is None:
        return _without_details(call.code(), message)
    info, retry = details
    metadata = info.metadata
    return GraphfixError(
        info.reason,
        message,
        remedy=metadata.get("remedy", ""),
        field=metadata.get("field"),
        retry_after_s=retry,
        byte_offset=_number(metadata, "byteOffset"),
        line=_number(metadata, "line"),
        is_passing=call.code() == grpc.StatusCode.DEADLINE_EXCEEDED,
    )


def unreachable(message: str) -> ServiceUnreachableError:
    """The error of a service that does not answer."""
    remedy = "check that the service runs and the URL names it"
    return ServiceUnreachableError("SERVICE_UNREACHABLE", message, remedy=remedy, is_passing=True)


def _without_details(status: grpc.StatusCode, message: str) -> GraphfixError:
    """An error that gRPC or a proxy made; one within HTTP/2 is a broken connection."""
    if status in _BREAKS or status == grpc.StatusCode.INTERNAL:
        return unreachable(message)
    return GraphfixError(status.name, message)


def _details(call: grpc.Call) -> tuple[error_details_pb2.ErrorInfo, float | None] | None:
    """The service's code with what belongs to it, and the delay (s)."""
    try:
        status: status_pb2.Status | None = rpc_status.from_call(call)
    except (DecodeError, ValueError):
        return None
    found, delay_s = None, None
    for detail in status.details if status else []:
        info, retry = error_details_pb2.ErrorInfo(), error_details_pb2.RetryInfo()
        if detail.Unpack(info) and info.domain == _DOMAIN:
            found = info
        elif detail.Unpack(retry):
            delay_s = retry.retry_delay.ToTimedelta().total_seconds()
    return None if found is None else (found, delay_s)


def _number(metadata: Mapping[str, str], key: str) -> int | None:
    return int(metadata[key]) if key in metadata else None
