"""What the user is told: sizes in words, what arguments must be, faults in one sentence."""

from __future__ import annotations

import functools
import inspect
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeVar
from unicodedata import category

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "EXPECTED",
    "address_of",
    "advised_call",
    "as_numbers",
    "as_path",
    "check_bool",
    "check_call",
    "check_finite",
    "check_number",
    "check_positive",
    "check_type",
    "checked_call",
    "counted",
    "frame_in_words",
    "has_parts",
    "is_expected",
    "is_list",
    "is_table",
    "local_path",
    "printable",
    "sentence_of",
    "shown",
    "size_in_words",
    "time_in_words",
    "view_in_words",
    "view_of",
    "views_are_numbered",
    "wavelengths_of_views",
]


def size_in_words(size: float) -> str:
    """Return a number of bytes in the unit that suits it; a GB is 2**30 bytes, a MB 2**20.

    Examples
    --------
    >>> size_in_words(3 * 2**30)
    '3.0 GB'
    """
    if size >= 2**30:
        return f"{size / 2**30:.1f} GB"
    return f"{size / 2**20:.0f} MB" if size >= 10 * 2**20 else f"{size / 2**20:.1f} MB"


def time_in_words(seconds: float) -> str:
    """Return a time in the unit that suits it.

    Examples
    --------
    >>> time_in_words(600)
    '10 min'
    """
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def views_are_numbered(angles_deg: Sequence[float]) -> bool:
    """Say whether views are only numbered, 0, 1, 2 ..., as they are until angles are given.

    Examples
    --------
    >>> views_are_numbered([0, 1]), views_are_numbered([-7, 21])
    (True, False)
    """
    return len(angles_deg) > 1 and list(angles_deg) == list(range(len(angles_deg)))


def view_in_words(
    angles_deg: Sequence[float],
    number: int,
    what: str = "",
    wavelengths_um: Sequence[float] | None = None,
) -> str:
    """Return a view's angle, or its number, counted from 1, where nobody has given angles.

    ``what`` is said before an angle only. Views of several wavelengths are told apart by these.

    Examples
    --------
    >>> view_in_words([-7, 21], 1), view_in_words([0, 1], 1)
    ('21°', 'view 2')
    >>> view_in_words([-7, 21], 0, "angle "), view_in_words([0, 1], 0, "angle ")
    ('angle -7°', 'view 1')
    >>> view_in_words([21, 21], 1, "angle ", [0.532, 0.6328])
    'angle 21°, 632.8 nm'
    """
    light = "" if wavelengths_um is None else f", {1000 * wavelengths_um[number]:.6g} nm"
    if views_are_numbered(angles_deg):
        return f"view {number + 1}{light}"
    return f"{what}{angles_deg[number]:.4g}°{light}"


def view_of(stack: Any, number: int, what: str = "") -> str:
    """Return what is said of a view of a stack by its number, see `view_in_words`.

    Parameters
    ----------
    stack : xarray.DataArray
        With or without the coordinates "angle" and, where there are several, "wavelength".
    number : int
        From 0.
    what : str, optional
        Said before an angle.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> view_of(xr.DataArray(np.zeros(2), dims="angle"), 1)
    'view 2'
    """
    if "angle" not in stack.coords:
        return f"view {number + 1}"
    angles = np.atleast_1d(stack["angle"].values).tolist()
    return view_in_words(angles, number, what, wavelengths_of_views(stack))


def wavelengths_of_views(stack: Any) -> list[float] | None:
    """Return the wavelength of each view in micrometres where they have several; else None."""
    lights = stack.coords.get("wavelength")
    several = lights is not None and lights.ndim > 0 and len(set(lights.values.tolist())) > 1
    return lights.values.tolist() if several else None


def frame_in_words(stack: Any, time: int, angle: int) -> str:
    """Return what is said of a frame of a stack by its numbers.

    Parameters
    ----------
    stack : xarray.DataArray
        Along an axis without coordinates, the number is said.
    time, angle : int
        Numbers from 0; that of an axis that the stack has not does not count.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> axes = {"time": [0, 35 / 6], "angle": [-7, 21]}
    >>> frame_in_words(xr.DataArray(np.zeros((2, 2)), coords=axes, dims=("time", "angle")), 1, 1)
    'time 5.83 s, angle 21°'
    """
    parts, placed = [], [axis for axis in stack.dims if axis in stack.coords]
    if "time" in placed:
        seconds = float(stack["time"].values[time])
        parts.append(f"time {seconds:.0f} s" if abs(seconds) >= 1000 else f"time {seconds:.3g} s")
    elif "time" in stack.dims:
        parts.append(f"time {time}")
    if "angle" in stack.dims:
        parts.append(view_of(stack, angle, "angle "))
    return ", ".join(parts)


def counted(number: object, what: str) -> str:
    """Return a number with what it counts.

    Examples
    --------
    >>> counted(1, "frame"), counted(2, "frame")
    ('1 frame', '2 frames')
    """
    return f"{number} {what}" if str(number) == "1" else f"{number} {what}s"


#: How an address begins; a path keeps one of the two slashes.
SCHEME = re.compile(r"(https?|s3):/{1,2}(?=[^/])", re.IGNORECASE)
#: Kinds of letters that are not seen but steer: control, format, surrogates, ends of lines.
STEERING = {"Cc", "Cf", "Cs", "Zl", "Zp"}


def check_number(name: str, value: Any) -> float:
    """Return a number as float; TypeError if it is none."""
    if isinstance(value, bool) or not isinstance(value, Real):
        msg = f"{name} must be a number, but is {shown(value)}"
        raise TypeError(msg)
    try:
        return float(value)
    except OverflowError as error:
        msg = f"{name} is too large a number"
        raise ValueError(msg) from error


def check_finite(name: str, value: Any) -> float:
    """Return a number as float; ValueError if it is NaN or infinite."""
    number = check_number(name, value)
    if not math.isfinite(number):
        msg = f"{name} must be a finite number, but is {shown(value)}"
        raise ValueError(msg)
    return number


def check_positive(name: str, value: Any, most: float = 1e12) -> float:
    """Return a number above 0 as float; ValueError if it is not, or not finite."""
    number = check_number(name, value)
    if not 0 < number <= most:
        msg = f"{name} must be a number above 0, at most {most:g}, but is {shown(value)}"
        raise ValueError(msg)
    return number


def check_call(name: str, value: Any) -> None:
    """Raise TypeError for what can't be called; None is nothing to call."""
    if value is not None and not callable(value):
        msg = f"{name} must be a function, but is {shown(value)}"
        raise TypeError(msg)


def check_bool(name: str, value: Any) -> None:
    """Raise TypeError for what is neither True nor False: "no" would count as True."""
    if not isinstance(value, bool) and type(value).__name__ not in ("bool", "bool_"):
        msg = f"{name} must be True or False, but is {shown(value)}"
        raise TypeError(msg)


def check_type(name: str, value: Any, wanted: type, advice: str) -> None:
    """Raise TypeError for what is of another class, and say where to get the right one."""
    if not isinstance(value, wanted):
        kind = wanted.__name__
        msg = f"{name} must be {article_of(kind)} {kind}, but is {type(value).__name__}; {advice}"
        raise TypeError(msg)


# ---- what a function says that it takes ------------------------------------------------------

P = ParamSpec("P")
R = TypeVar("R")

#: How a kind that a function names is called in a sentence, and what is of that kind.
KINDS: Mapping[str, tuple[str, Callable[[Any], bool]]] = {
    "None": ("None", lambda value: value is None),
    "bool": ("True or False", lambda value: type(value).__name__ in ("bool", "bool_")),
    "int": (
        "a whole number", lambda value: isinstance(value, Integral) and not isinstance(value, bool)
    ),
    "float": ("a number", lambda value: is_number(value)),
    "str": ("a text", lambda value: isinstance(value, str)),
    "Path": ("a path", lambda value: isinstance(value, PathLike)),
    "xr.DataArray": ("a DataArray", lambda value: is_of(value, "xarray", "DataArray")),
    "xr.Dataset": ("a Dataset", lambda value: is_of(value, "xarray", "Dataset")),
    "pd.DataFrame": ("a DataFrame", lambda value: is_of(value, "pandas", "DataFrame")),
    "Figure": ("a Figure of matplotlib", lambda value: is_of(value, "matplotlib", "Figure")),
    "Mapping": ("a mapping of names", lambda value: isinstance(value, Mapping)),
    "Sequence": ("a list", lambda value: is_list(value)),
    "tuple": ("a list", lambda value: is_list(value)),
    "Iterable": ("a list", lambda value: has_parts(value)),
    "ProgressCall": ("a function", callable),
    "CancelledCall": ("a function", callable),
    "Callable": ("a function", callable),
}  # fmt: skip
#: Longer lists are not looked at number by number.
LOOKED_AT = 1000


def checked_call(function: Callable[P, R]) -> Callable[P, R]:
    """Have a function refuse, in one sentence, what is of no kind that it says it takes.

    Kinds are those of its annotations; what they name that is not known here is not looked at.
    """
    return advised_call()(function)


def advised_call(**advice: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Do as `checked_call`, and say of an argument by this name where to get the right one."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        call: Callable[..., R] = function

        def right(name: str, value: Any) -> Any:
            return as_taken(name, value, call, advice.get(name, ""))

        @functools.wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            names = taken_by(call)
            more = args[len(names) :]  # too many, which Python refuses
            in_order = [right(name, value) for name, value in zip(names, args, strict=False)]
            named = {name: right(name, value) for name, value in kwargs.items()}
            return call(*in_order, *more, **named)

        return checked

    return decorate


@functools.cache
def taken_by(function: Callable[..., Any]) -> dict[str, str]:
    """Return what a function says that it takes, by the names of its arguments, in their order."""
    return {name: str(p.annotation) for name, p in inspect.signature(function).parameters.items()}


def as_taken(name: str, value: Any, function: Callable[..., Any], advice: str) -> Any:
    """Return a value as a function takes it; TypeError if it is of no kind that this says."""
    said = taken_by(function).get(name)
    if said is None or is_any_of(value, said, function):
        return value
    plain = as_plain(value)
    if is_any_of(plain, said, function):
        return plain
    end = f"; {advice}" if advice else ""
    msg = f"{name} must be {in_words(said, function)}, but is {shown(value)}{end}"
    raise TypeError(msg)


def as_plain(value: Any) -> Any:
    """Return an array of no axis as its number and a column of a table as a list."""
    if is_of(value, "pandas", "Series"):
        return list(value)
    if getattr(value, "ndim", None) != 0 or isinstance(value, np.ma.MaskedArray):
        return value
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    return value.item() if kind and kind in "iuf" else value


def fits(value: Any, said: str, function: Callable[..., Any]) -> bool:
    """Say whether a value, or the number or the list that it stands for, is of a kind."""
    return is_any_of(value, said, function) or is_any_of(as_plain(value), said, function)


def is_any_of(value: Any, said: str, function: Callable[..., Any]) -> bool:
    """Say whether a value is of a kind that an annotation names."""
    return any(is_kind(value, one, function) for one in parts_of(said, "|"))


def is_kind(value: Any, said: str, function: Callable[..., Any]) -> bool:
    """Say whether a value is of one kind, as are its parts where it is a list or a mapping."""
    head, inside = head_of(said)
    if head not in KINDS:
        return is_of_class(value, head, function)
    look = PARTS.get(head)
    if not KINDS[head][1](value):
        return False
    return look is None or look(value, parts_of(inside, ","), function)


def is_of_class(value: Any, name: str, function: Callable[..., Any]) -> bool:
    """Say whether a value is of a class as a function's module knows it; what else may be."""
    known = function.__globals__.get(name)
    return known is Any or not inspect.isclass(known) or isinstance(value, known)


def pairs_fit(value: Any, kinds: Sequence[str], function: Callable[..., Any]) -> bool:
    """Say whether names and values of a mapping are of their kinds."""
    if len(kinds) != 2:
        return True
    pairs = islice(value.items(), LOOKED_AT)
    return all(fits(k, kinds[0], function) and fits(v, kinds[1], function) for k, v in pairs)


def values_fit(value: Any, kinds: Sequence[str], function: Callable[..., Any]) -> bool:
    """Say whether a list holds as many values as there are kinds, each of its own."""
    if "..." in kinds or not kinds:
        return all_fit(value, kinds, function)
    return len(value) == len(kinds) and all(
        fits(one, kind, function) for one, kind in zip(value, kinds, strict=True)
    )


def all_fit(value: Any, kinds: Sequence[str], function: Callable[..., Any]) -> bool:
    """Say whether all parts are of a kind; what may give its parts only once is not looked at."""
    is_array = hasattr(value, "dtype") and hasattr(value, "__getitem__")
    if not kinds or not (is_array or isinstance(value, (list, tuple))):
        return True
    if is_array:  # its numbers, or its rows, are all of one kind
        value = np.asarray(value[: 1 if value.dtype.kind in "biufc" else LOOKED_AT])
    return all(fits(one, kinds[0], function) for one in islice(value, LOOKED_AT))


#: What looks at the parts of a kind.
PARTS: Mapping[str, Callable[[Any, Sequence[str], Callable[..., Any]], bool]] = {
    "Mapping": pairs_fit,
    "tuple": values_fit,
    "Sequence": all_fit,
    "Iterable": all_fit,
}


def head_of(said: str) -> tuple[str, str]:
    """Return the name of a kind and what it says in brackets."""
    head, _, inside = said.removesuffix("]").partition("[")
    return head, inside


@functools.cache
def parts_of(said: str, sign: str) -> tuple[str, ...]:
    """Return the parts of an annotation between signs outside of brackets."""
    found, depth = [""], 0
    for letter in said:
        depth += (letter == "[") - (letter == "]")
        if letter == sign and not depth:
            found.append("")
        else:
            found[-1] += letter
    return tuple(part.strip() for part in found if part.strip())


def in_words(said: str, function: Callable[..., Any]) -> str:
    """Return what an annotation says, for a sentence."""
    words = []
    for one in parts_of(said, "|"):
        head, inside = head_of(one)
        named = KINDS[head][0] if head in KINDS else f"{article_of(head)} {head}"
        kinds = [kind for kind in parts_of(inside, ",") if kind != "..."]
        if head == "tuple" and len(kinds) > 1:
            named = f"{len(kinds)} values, each {in_words(kinds[0], function)}"
        elif head in ("Sequence", "tuple", "Iterable") and kinds:
            named = f"a list, each {in_words(kinds[0], function)}"
        if named not in words:
            words.append(named)
    return " or ".join(words)


def is_number(value: Any) -> bool:
    """Say whether a value is a real number that a computer can reckon with."""
    try:
        check_number("", value)
    except (TypeError, ValueError):
        return False
    return True


def article_of(name: str) -> str:
    """Return the article of a name."""
    return "an" if name[:1] in "AEIOU" else "a"


def is_of(value: Any, package: str, kind: str) -> bool:
    """Say whether a value is of a class of a package, which is not loaded for it."""
    return any(
        c.__name__ == kind and c.__module__.partition(".")[0] == package
        for c in type(value).__mro__
    )


def is_list(value: Any) -> bool:
    """Say whether a value has parts in an order."""
    return has_parts(value) and hasattr(value, "__len__") and not is_table(value)


def has_parts(value: Any) -> bool:
    """Say whether a value gives parts one by one, of which no one need know how many."""
    if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Iterable):
        return False
    axes = getattr(value, "ndim", 1)
    return axes == 1 or (axes > 0 and not is_table(value))


def is_table(value: Any) -> bool:
    """Say whether a value has parts by names."""
    return is_of(value, "pandas", "NDFrame") or is_of(value, "xarray", "Dataset")


def as_numbers(name: str, values: Any) -> NDArray[Any]:
    """Return real numbers as an array, NaN where masked; TypeError if they are none."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "iuf":
        values = np.ma.filled(values.astype(np.result_type(values.dtype, np.float32)), np.nan)
    try:
        found = np.asarray(values)
    except ValueError as error:
        msg = f"{name} must be numbers in rows of one length, but is {shown(values)}"
        raise TypeError(msg) from error
    except Exception as error:  # whatever another package says of its own arrays
        msg = f"{name} must be real numbers, but is {shown(values)}"
        raise TypeError(msg) from error
    if found.dtype.kind not in "biuf":
        msg = f"{name} must be real numbers, but is {shown(values)}"
        raise TypeError(msg)
    return found


def as_path(path: Any, advice: str = "") -> Path:
    """Return a path; TypeError for what is none, with advice, ValueError for an empty word.

    An empty word, such as a variable of a script that was never set, would be the folder that the
    program runs in.
    """
    if not isinstance(path, (str, PathLike)):
        what = type(path).__name__ + (f"; {advice}" if advice else "")
        msg = f"path must be a file or folder, but is {what}"
        raise TypeError(msg)
    if not os.fspath(path):
        msg = 'the name of a file or folder is empty; "." is the folder that the program runs in'
        raise ValueError(msg)
    name = os.fspath(path)
    try:
        fit = "\0" not in name and bool(os.fsencode(name))
    except UnicodeEncodeError:
        fit = False
    if not fit:
        msg = f"{shown(name)} can't be the name of a file; it holds letters that no disk takes"
        raise ValueError(msg)
    return Path(path)


def address_of(given: str | PathLike[str]) -> str | None:
    """Return the address of a server that a text or path stands for; None for a file or folder.

    Parameters
    ----------
    given : str or path, with either slash

    Returns
    -------
    str or None, with its scheme in small letters and no slash at the end

    Examples
    --------
    >>> address_of("https://example.org/cell.zarr"), address_of(Path("s3://lab/cell.zarr"))
    ('https://example.org/cell.zarr', 's3://lab/cell.zarr')
    >>> address_of("cell.zarr") is None
    True
    """
    text = os.fspath(given).replace("\\", "/")  # as a path of Windows has it
    found = SCHEME.match(text)
    return None if found is None else f"{found[1].lower()}://{text[found.end() :].rstrip('/')}"


def local_path(path: Any) -> Path:
    """Return the path of a file or folder of this machine; OSError for an address."""
    if isinstance(path, (str, PathLike)) and address_of(path) is not None:
        msg = f"{address_of(path)} lies on a server; results are written and read here only"
        raise OSError(msg)
    return as_path(path)


def printable(text: str) -> str:
    r"""Return a text in one line with what can't be printed as an escape.

    Names of files may hold line feeds, and what makes a terminal change its colours or its title.

    Examples
    --------
    >>> printable("cell\x1b[31m\n2.tif")
    'cell\\x1b[31m\\n2.tif'
    """
    return "".join(
        letter.encode("unicode_escape").decode() if category(letter) in STEERING else letter
        for letter in text
    )


def shown(value: Any) -> str:
    """Return a value in one short line."""
    if hasattr(value, "dims") or (hasattr(value, "shape") and getattr(value, "ndim", 0) > 0):
        return f"{type(value).__name__} of shape {getattr(value, 'shape', ())}"
    line = " ".join(repr(value).split())
    return line if len(line) <= 80 else f"{line[:77]}..."


#: Faults whose sentence is for the user.
EXPECTED = (ImportError, MemoryError, OSError, TypeError, ValueError)


def is_expected(error: BaseException) -> bool:
    """Say whether an error has a sentence of its own that is for the user."""
    return isinstance(error, MemoryError) or (isinstance(error, EXPECTED) and bool(str(error)))


def sentence_of(error: BaseException) -> str:
    """Return an error in one line, without its number."""
    if isinstance(error, OSError) and error.strerror:
        where = "" if error.filename is None else f" ({error.filename})"
        return printable(f"{error.strerror}{where}")
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    words = printable(" ".join(str(error).split()))
    if is_expected(error):
        return words
    return f"an unexpected fault, {type(error).__name__}" + (f": {words}" if words else "")
