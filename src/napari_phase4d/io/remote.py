"""Zarr stores behind an address: http, https and S3, through fsspec, a frame at a time."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from napari_phase4d.io.lazy import Unsound, in_one_line
from napari_phase4d.words import address_of

__all__ = ["address_of", "is_missing", "remote_store", "unreached"]

#: Seconds to wait for an answer, and between two parts of it.
CONNECT_S, READ_S = 10.0, 30.0
#: Files of which one at least describes what a store holds.
DESCRIPTIONS = ("zarr.json", ".zmetadata", ".zgroup", ".zattrs", ".zarray")
INSTALL = 'pip install "napari-phase4d[remote]"'


def remote_store(address: str) -> Any:
    """Return the Zarr store behind an address, which reads only.

    Raises
    ------
    Unsound
        If the packages are missing that read over the network.
    """
    from zarr.storage import FsspecStore

    class NotingStore(FsspecStore):  # type: ignore[misc]
        """Notes what the server does not have, which Zarr takes for black."""

        missing: set[str]

        async def get(self, key: str, *how: Any, **more: Any) -> Any:
            try:
                found = await super().get(key, *how, **more)
            except Exception as error:
                # Who may not list what is there is told so also of what is not there.
                if key.rpartition("/")[2] not in DESCRIPTIONS or not is_forbidden(error):
                    raise
                found = None
            if found is None:
                self.missing.add(key)
            return found

    try:
        store = NotingStore.from_url(address, storage_options=options_for(address), read_only=True)
        store.missing = set()
        return store
    except ImportError as error:
        msg = f"{address} lies on a server; to read it there, {INSTALL}"
        raise Unsound(msg) from error


def options_for(address: str) -> dict[str, Any]:
    """Return how fsspec is to reach an address: no wait without an end."""
    if address.startswith("s3:"):
        # Public data needs no name; who has one has said so where every program for S3 looks.
        waits: dict[str, Any] = {
            "connect_timeout": CONNECT_S,
            "read_timeout": READ_S,
            "retries": {"max_attempts": 2},
        }
        # Named here, as fsspec keeps what it has once connected to.
        endpoint = os.environ.get("AWS_ENDPOINT_URL")
        return {
            "anon": not has_credentials(),
            "config_kwargs": waits,
            **({"endpoint_url": endpoint} if endpoint else {}),
        }
    try:
        from aiohttp import ClientTimeout
    except ImportError:  # said in words by the caller
        return {}
    return {"client_kwargs": {"timeout": ClientTimeout(sock_connect=CONNECT_S, sock_read=READ_S)}}


def has_credentials() -> bool:
    """Say whether a name for S3 is set in the environment or in the usual file."""
    named = any(os.environ.get(f"AWS_{key}") for key in ("ACCESS_KEY_ID", "PROFILE", "ROLE_ARN"))
    usual = os.environ.get("AWS_SHARED_CREDENTIALS_FILE", "~/.aws/credentials")
    return named or Path(usual).expanduser().is_file()


def is_forbidden(error: BaseException) -> bool:
    """Say whether a server refused to answer."""
    return isinstance(error, PermissionError) or getattr(error, "status", None) in (401, 403)


def is_missing(store: Any, key: str) -> bool:
    """Say whether a piece is not on the server; any other fault is raised."""
    from zarr.abc.store import RangeByteRequest
    from zarr.core.buffer import default_buffer_prototype
    from zarr.core.sync import sync

    beginning = RangeByteRequest(0, 1)
    return sync(store.get(key, default_buffer_prototype(), beginning)) is None


def unreached(address: str, error: BaseException | None) -> str:
    """Return the sentence for an address where no store can be read."""
    if error is None or isinstance(error, FileNotFoundError):
        return f"there is no Zarr store at {address}, or none that may be read"
    return f"{address} can't be read ({in_one_line(error)}); check the address and the network"
