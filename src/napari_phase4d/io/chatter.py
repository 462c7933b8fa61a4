"""Keeping the remarks of libraries from users, who can't act on them."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["quiet"]

#: Whether this thread is inside `quiet`.
SILENT: ContextVar[bool] = ContextVar("phase4d_silent", default=False)


def is_heard(record: logging.LogRecord) -> bool:
    """Say whether a remark may be shown."""
    return not SILENT.get()


@contextmanager
def quiet(name: str = "tifffile") -> Iterator[None]:
    """Keep back what a library logs meanwhile in this thread; others' use of it is not touched."""
    logger = logging.getLogger(name)
    logger.addFilter(is_heard)  # the same function again changes nothing
    token = SILENT.set(True)
    try:
        yield
    finally:
        SILENT.reset(token)
