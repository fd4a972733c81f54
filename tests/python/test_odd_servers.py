"""Answers that no server of ours gives."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent import futures
from typing import Any

import grpc
import pytest

from sandgait import _native


def field(number: int, content: bytes) -> bytes:
    """A field of protobuf with a length below 128."""
    return bytes([number << 3 | 2, len(content)]) + content


def serve(infos: bytes) -> tuple[grpc.Server, int]:
    """A server whose sessions answer each request with two environments with these bytes of `infos`."""
    columns = {1: bytes(16), 2: bytes(8), 3: bytes(2), 4: bytes(2), 5: infos}
    batch = b"".join(field(number, content) for number, content in columns.items())

    def run_session(requests: Iterator[bytes], _: Any) -> Iterator[bytes]:
        next(requests)
        yield field(4, b"")  # Attached
        for _request in requests:
            yield b"\x08\x01" + field(2, batch)

    handler = grpc.stream_stream_rpc_method_handler(run_session)
    service = grpc.method_handlers_generic_handler("sandgait.v1.EnvironmentService", {"RunSession": handler})
    server = grpc.server(futures.ThreadPoolExecutor(1))
    server.add_generic_rpc_handlers((service,))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    return server, port


@pytest.mark.parametrize("size", [5, 20, 22])
def test_a_part_of_a_row(size: int) -> None:
    """In an earlier version, five numbers for two environments ended in a panic."""
    server, port = serve(bytes(size))
    stream = _native.Stream((f"127.0.0.1:{port}", None, False, None, None, None), "x")
    request = _native.Request.save()
    request.sequence = 1
    stream.send(request, True)
    with pytest.raises(Exception, match="columns of different lengths"):
        stream.receive().batch()
    server.stop(None)


def test_whole_rows() -> None:
    server, port = serve(bytes(24))
    stream = _native.Stream((f"127.0.0.1:{port}", None, False, None, None, None), "x")
    request = _native.Request.save()
    request.sequence = 1
    stream.send(request, True)
    assert [part.shape for part in stream.receive().batch()][:5] == [(2, 2), (2,), (2,), (2,), (3, 2)]
    server.stop(None)
