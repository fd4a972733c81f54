"""The embedded server: one `sandgait serve` per Python process, on a Unix socket that only this user can reach.

The server starts with the first environment that is `isolated`. Its standard input is a pipe from this process. When
this process ends, for whatever reason, the pipe closes, and then the server ends.

All isolated environments of a process share the server and its threads. The first requested number of threads is used
(`ask_for_threads`).
"""

from __future__ import annotations

import atexit
import contextlib
import os
import secrets
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from .errors import SandgaitError, ServerLost
from .threads import agreed, wanted

#: Longest wait for the server to answer after its start [s]: our choice, because a busy machine may delay the start.
START_TIMEOUT = 20.0

#: Longest wait for the server to end by itself [s]: our choice, two seconds more than it needs at most after its input
#: closes. After this time it is killed.
STOP_TIMEOUT = 7.0


def command() -> list[str]:
    """The command that runs `sandgait`: $SANDGAIT_BINARY if it is set, else this package in a Python process."""
    chosen = os.environ.get("SANDGAIT_BINARY")
    if not chosen:
        program = Path(__file__).parents[1] / "sandgait_command" / "__main__.py"
        return [sys.executable, "-I", "-S", str(program)]
    if not os.access(chosen, os.X_OK):
        raise SandgaitError(f"SANDGAIT_BINARY: {chosen!r} is not a program that can be run")
    return [chosen]


class EmbeddedServer:
    """A server process and its socket. `threads`: number of simulating threads; 0: one for each processor."""

    def __init__(self, threads: int = 0) -> None:
        if not hasattr(socket, "AF_UNIX") or not hasattr(os, "getuid"):
            raise SandgaitError(
                "address: this system has no Unix sockets, which the embedded server needs; run `sandgait serve` on "
                "Linux, macOS or in WSL and give its address"
            )
        self.threads = threads
        self.command = command()
        self.owner = os.getpid()
        self.path = os.path.join(_private_directory(), f"{self.owner}-{secrets.token_hex(4)}")
        self.address = f"unix:{self.path}"
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - the file stays open as long as the server runs
        self.process = subprocess.Popen(
            [*self.command, "serve", "--listen", self.address, "--exit-on-stdin-close", "--threads", str(threads)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._log,
            env={"SANDGAIT_LOG": "warn", **os.environ},  # the log's last lines say why a server could not start
            start_new_session=True,  # Ctrl-C reaches only Python; the server ends when its pipe closes
        )
        try:
            self._wait_until_ready()
        except BaseException:
            self.stop()
            raise

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + START_TIMEOUT
        while True:
            with socket.socket(socket.AF_UNIX) as probe:
                try:
                    probe.connect(self.path)
                    return
                except OSError:
                    pass
            if self.process.poll() is not None:
                raise ServerLost(f"{self.command[-1]} could not start{self.last_words()}")
            if time.monotonic() > deadline:
                raise ServerLost(f"{self.command[-1]} did not answer within {START_TIMEOUT:.0f} s{self.last_words()}")
            time.sleep(0.002)

    def running(self) -> bool:
        return self.process.poll() is None

    def last_words(self) -> str:
        """Exit code of the server and the end of its log; empty while it runs."""
        if self.running():
            return ""
        size = self._log.seek(0, os.SEEK_END)
        self._log.seek(max(0, size - 2000))
        text = self._log.read().decode(errors="replace").strip()
        return f"; it ended with exit code {self.process.returncode}" + (f": {text}" if text else "")

    def stop(self) -> None:
        """Ends the server, if this process started it."""
        if self.owner != os.getpid():
            return
        if self.process.stdin is not None:
            self.process.stdin.close()
        try:
            self.process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        with contextlib.suppress(FileNotFoundError):  # the server removes the socket unless it was killed
            os.unlink(self.path)
        self._log.close()

    def disown(self) -> None:
        """In a forked child: closes the pipe, so that the server ends with the parent."""
        if self.process.stdin is not None:
            self.process.stdin.close()


def _private_directory() -> str:
    """The directory for the sockets of all servers of this user. No other user may enter it."""
    parent = tempfile.gettempdir()
    if len(os.fsencode(parent)) > 70:  # a socket's path can have some 100 bytes
        parent = "/tmp"
    path = os.path.join(parent, f"sandgait-{os.getuid()}")
    with contextlib.suppress(FileExistsError):
        os.mkdir(path, 0o700)
    status = os.lstat(path)
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise SandgaitError(f"{path}: not a directory that only this user can enter; remove it, or set TMPDIR")
    return path


_lock = threading.Lock()
_server: EmbeddedServer | None = None
_inherited: list[EmbeddedServer] = []
#: Number of threads that environments have requested. None if no environment has; then SANDGAIT_THREADS is used.
_threads: int | None = None


def ask_for_threads(threads: int | None) -> None:
    """Requests a number of threads for the embedded server; with None any number is accepted.

    The request is refused if a server runs with another number.
    """
    global _threads
    if threads is None:
        return
    with _lock:
        has = _server.threads if _server is not None and _server.running() else None
        _threads = agreed(threads, has, "the server of this process")


def _threads_wanted() -> int:
    """Number of threads of a server that starts now; 0: one for each processor."""
    return wanted() if _threads is None else _threads


def address() -> str:
    """Address of this process's embedded server. Starts the server if it does not run."""
    global _server
    with _lock:
        if _server is not None and not _server.running():
            _server.stop()
            _server = None
        if _server is None:
            _server = EmbeddedServer(_threads_wanted())
        return _server.address


def is_dead(address: str) -> bool:
    """Is this the address of an embedded server that has ended? No other server will use this address."""
    server = _server
    if server is None or server.address != address:
        return _is_ours(address)
    with contextlib.suppress(subprocess.TimeoutExpired):
        server.process.wait(0.05)  # a connection closes shortly before the process has ended
    return not server.running()


def _is_ours(address: str) -> bool:
    """Is this the address of an embedded server, of this process or another?"""
    if not address.startswith("unix:") or not hasattr(os, "getuid"):
        return False
    return os.path.dirname(address.removeprefix("unix:")) == _private_directory()


def last_words(address: str) -> str:
    """The last log lines of the embedded server at `address`, if it has ended; empty for every other server."""
    server = _server
    if server is None or server.address != address:
        return ""
    with contextlib.suppress(subprocess.TimeoutExpired):
        server.process.wait(0.5)  # a connection closes shortly before the process has ended
    return server.last_words()


def _stop() -> None:
    if _server is not None:
        _server.stop()


def _after_fork() -> None:
    """Makes a forked child start its own server. The parent's object is kept, so that the child runs no finalizer."""
    global _server, _lock
    _lock = threading.Lock()
    if _server is not None:
        _server.disown()
        _inherited.append(_server)
        _server = None


atexit.register(_stop)
if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_after_fork)
