"""Addresses of servers that require TLS, a token or a certificate."""

from __future__ import annotations

import ipaddress
import os
from os import PathLike

from .arguments import checked
from .errors import InvalidRequest
from .files import read_within

FilePath = str | PathLike[str]


class Remote(str):
    """The address of a server with credentials. It can be used for every argument `address`.

        gymnasium.make_vec(id, num_envs=256, address=sandgait.Remote("sand.lab:50051", ca="ca.pem", token_file="token"))

    `address`: `host:port` or `unix:/path`.

    `token`, `token_file`: the content of the server's `--token-file`. Every call sends the token, but only over TLS,
    over a Unix socket or to this machine.

    `ca`: the connection is encrypted, and certificates of this authority are trusted (PEM, as a file or as bytes).
    `tls=True`: the connection is encrypted, and the system's authorities are trusted.

    `cert`, `key`: this client's certificate and its key (PEM files), for a server with `--client-ca`.

    The files are read when the object is made. `str` and `repr` show the address without the token.
    """

    token: str | None
    ca: bytes | None
    cert: bytes | None
    key: bytes | None
    tls: bool

    @checked
    def __new__(
        cls,
        address: str,
        *,
        token: str | None = None,
        token_file: FilePath | None = None,
        ca: FilePath | bytes | None = None,
        cert: FilePath | None = None,
        key: FilePath | None = None,
        tls: bool = False,
    ) -> Remote:
        self = super().__new__(cls, address)
        if token is not None and token_file is not None:
            raise InvalidRequest("token: token_file is given too")
        if (cert is None) != (key is None):
            raise InvalidRequest("cert, key: one is given without the other")
        if token_file is not None:
            token = _read(token_file, "token_file").decode(errors="replace").strip()
        if token is not None and not (token.isascii() and token.isprintable() and token and " " not in token):
            raise InvalidRequest("token: empty, or with characters other than visible ASCII ones")
        self.token = token
        self.ca, self.cert, self.key = (
            pem if pem is None or isinstance(pem, bytes) else _read(pem, name)
            for pem, name in ((ca, "ca"), (cert, "cert"), (key, "key"))
        )
        self.tls = tls or ca is not None or cert is not None
        if self.tls and address.startswith("unix:"):
            raise InvalidRequest(f"address: {address} is a Unix socket, which has no TLS")
        if token is not None and not self.tls and not _is_local(address):
            raise InvalidRequest(f"token: it would be sent to {address} without encryption; add ca or tls=True")
        return self


def _read(path: FilePath, name: str) -> bytes:
    try:
        return read_within(path)
    except OSError as error:
        raise InvalidRequest(f"{name}: {os.fspath(path)!r} cannot be read: {error.strerror}") from error


def _is_local(address: str) -> bool:
    host = address.rpartition(":")[0].strip("[]")
    if address.startswith("unix:") or host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
