"""Units of coordinates and of phase, converted by pint."""

from __future__ import annotations

from functools import cache
from types import MappingProxyType
from typing import Any

__all__ = ["ANGLE", "factor_to"]

#: The base unit of all angles; pint counts it as a pure number, as percent and counts are.
ANGLE = "radian"
#: Units as pint calls them -> how they are mostly written.
SHORT = MappingProxyType({"micrometer": "um", "degree": "deg", "second": "s", "radian": "rad"})
#: What is said to be a unit of length by pint, but is none that a microscope has.
PIXELS = ("px", "pixel", "pixels")


@cache
def registry() -> Any:
    """Return all units that are known; loaded when first asked for, which takes a second."""
    import pint

    return pint.UnitRegistry()


@cache
def factor_to(units: str, wanted: str) -> float | None:
    """Return what numbers in some units are multiplied by, None if the units are of other things.

    Parameters
    ----------
    units : str
        As somebody wrote them: "nm", "ms", "degree".
    wanted : str
        "um", "s", "deg" or "rad".

    Examples
    --------
    >>> factor_to("nm", "um"), factor_to("s", "um")
    (0.001, None)
    """
    written = units.strip()
    if written == wanted:
        return 1.0
    if written.casefold() in PIXELS:
        return None
    try:
        one = registry().Quantity(1.0, registry().Unit(written))
        target = registry().Unit(wanted)
        if is_angle(one.units) != is_angle(target):
            return None
        return float(f"{one.to(target).magnitude:.15g}")
    except Exception:  # pint raises its own, AttributeError, TypeError or those of its parser
        return None


def is_angle(unit: Any) -> bool:
    """Say whether a unit is one of angles, and no other pure number."""
    return str(registry().get_root_units(unit)[1]) == ANGLE
