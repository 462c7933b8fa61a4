"""Units as files write them."""

from __future__ import annotations

from types import MappingProxyType

__all__ = ["MICROMETRES", "SECONDS"]

#: Unit -> how many micrometres it is.
MICROMETRES = MappingProxyType(
    {
        **dict.fromkeys(("um", "µm", "μm", "\\u00B5m", "micron", "microns", "micrometer"), 1.0),
        **dict.fromkeys(("micrometre", "micrometers", "micrometres"), 1.0),
        **dict.fromkeys(("nm", "nanometer", "nanometre"), 1e-3),
        **dict.fromkeys(("pm", "picometer", "picometre"), 1e-6),
        **dict.fromkeys(("Å", "\u212b", "A", "angstrom", "ångström"), 1e-4),
        **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
        **dict.fromkeys(("mm", "millimeter", "millimetre"), 1e3),
        **dict.fromkeys(("m", "meter", "metre"), 1e6),
    }
)
#: Unit -> how many seconds it is.
SECONDS = MappingProxyType(
    {
        **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
        **dict.fromkeys(("ms", "millisecond", "milliseconds"), 1e-3),
        **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
        **dict.fromkeys(("us", "µs", "μs", "microsecond", "microseconds"), 1e-6),
        **dict.fromkeys(("min", "minute", "minutes"), 60.0),
        **dict.fromkeys(("h", "hour", "hours"), 3600.0),
        **dict.fromkeys(("d", "day", "days"), 86400.0),
    }
)
