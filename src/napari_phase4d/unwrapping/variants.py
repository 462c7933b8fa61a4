"""Two forms of a published method: as described, and as PhaseTools computes it."""

from __future__ import annotations

__all__ = ["VARIANTS", "check_variant"]

VARIANTS = ("textbook", "phasetools")


def check_variant(variant: str) -> None:
    """Raise ValueError if there is no such variant."""
    if variant not in VARIANTS:
        msg = f'variant must be "textbook" or "phasetools", but is {variant!r}'
        raise ValueError(msg)
