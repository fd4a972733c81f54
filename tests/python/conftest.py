"""What the tests share."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from sandgait import server

ID = "sandgait/HexapodGait-v1"

#: First line of a program that is to be interrupted: what a shell starts in the background ignores SIGINT, and so would
#: all its children.
HEARS_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"


class RemoteServer:
    """A server that the client did not start."""

    def __init__(self, listen: str, *options: str) -> None:
        self.process = subprocess.Popen(
            [server.find_binary(), "serve", "--listen", listen, "--exit-on-stdin-close", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        #: As the server prints it once clients can connect.
        self.address = self.process.stdout.readline().removeprefix("listening on ").strip()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def __enter__(self) -> RemoteServer:
        return self

    def __exit__(self, *_: Any) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def remote() -> Iterator[RemoteServer]:
    with RemoteServer("127.0.0.1:0") as server:
        yield server
