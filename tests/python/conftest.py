"""Fixtures for several test files."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sandgait import server

ID = "sandgait/HexapodGait-v1"

#: Tests of many cases run a part of these in `make test`, which takes seconds, and all of them in `make test-long`.
LONG = "SANDGAIT_TEST_LONG" in os.environ

#: First line of a program that a test interrupts. A process that a shell started in the background ignores SIGINT, and
#: its children inherit this, so the program restores the default.
HEARS_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of the Ray cluster come first: later both workers of pytest would start a cluster at the same time."""
    items.sort(key=lambda item: item.path.name != "test_ray.py")


class RemoteServer:
    """A server that the client did not start."""

    def __init__(self, listen: str, *options: str) -> None:
        self._log = tempfile.NamedTemporaryFile("w")  # noqa: SIM115, closed in __exit__
        self.process = subprocess.Popen(
            [*server.command(), "serve", "--listen", listen, "--exit-on-stdin-close", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
        )
        assert self.process.stdout is not None
        #: The address, as the server prints it when clients can connect.
        self.address = self.process.stdout.readline().removeprefix("listening on ").strip()

    def address_of(self, words: str) -> str:
        """The address in the log's line with `words`; the server writes this line before its own address."""
        for _ in range(1000):
            for line in Path(self._log.name).read_text().splitlines():
                if words in line:
                    found = re.search(r"127\.0\.0\.1:\d+", line)
                    assert found, line
                    return found[0]
            time.sleep(0.01)
        raise AssertionError(f"no {words!r} in the log")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def __enter__(self) -> RemoteServer:
        return self

    def __exit__(self, *_: Any) -> None:
        self.process.kill()
        self.process.communicate()
        self._log.close()


@pytest.fixture
def remote() -> Iterator[RemoteServer]:
    with RemoteServer("127.0.0.1:0") as server:
        yield server
