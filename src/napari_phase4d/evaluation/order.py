"""Which of T/A and A/T suits an object, and what such a verdict rests on."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from napari_phase4d.evaluation.confidence import REFERENCE, turns_off
from napari_phase4d.evaluation.errors import wrong_cycle_share
from napari_phase4d.evaluation.itoh import order_shares
from napari_phase4d.unwrapping import METHODS

__all__ = ["best_known", "most_trusted", "order_verdict", "steps_sentence"]

BOTH = ("temporal-angular", "angular-temporal")
#: Results in the order in which a look at the steps relies on them.
TRUSTED = (REFERENCE, *BOTH, "temporal", "angular")
#: The choice between T/A and A/T makes no difference where they differ by less than this share of
#: all pixels, or by less than this part of what the worse one has: of 108 simulated recordings,
#: all 6 in which the one nearer to directional L1 was the worse one lie within that part.
LEAST_SHARE, LEAST_PART = 0.0005, 0.1


def most_trusted(results: Mapping[str, xr.DataArray]) -> str:
    """Return the id of the method among the results that is most to be relied on."""
    return next((m for m in TRUSTED if m in results), next(iter(results)))


def best_known(
    results: Mapping[str, xr.DataArray], truth: xr.DataArray | None = None
) -> tuple[xr.DataArray, str]:
    """Return the phase that is most to be relied on, and what it is in words."""
    if truth is not None:
        return truth, "the exact phase"
    method = most_trusted(results)
    return results[method], f"the result of {METHODS[method].label}"


def steps_sentence(margin: xr.Dataset, basis: str) -> str:
    """Say along which dimensions how many steps are too large to be unwrapped.

    Parameters
    ----------
    margin : Dataset
        What `itoh_margin` gives.
    basis : str
        What it was told from, in words, as `best_known` says it.
    """
    shares = ", ".join(
        f"{str(name).removeprefix('along_')} {100 * along.attrs['share_beyond']:.3g} %"
        for name, along in margin.data_vars.items()
    )
    return f"Steps beyond half a cycle, by {basis}: {shares}."


def order_verdict(
    results: Mapping[str, xr.DataArray],
    boundary: tuple[int, int] = (0, 0),
    truth: xr.DataArray | None = None,
) -> str:
    """Say in one sentence which of T/A and A/T suits the object better, and why.

    Where the truth is known, the one that is right in more pixels, or, before both were run, the
    one that meets fewer steps beyond half a cycle; where the result of directional L1 is, the one
    that is nearer to it. The results of the two alone can't tell: that of T/A looks smooth along
    the angle, because its last pass made it so, and that of A/T along time.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of some methods.
    boundary : tuple of int, optional
        The optically thin frame (time, angle).
    truth : DataArray, optional
        Exact phase, where it is known.
    """
    both = all(method in results for method in BOTH)
    reference = METHODS[REFERENCE].label
    if truth is not None and both:
        wrong = {m: wrong_cycle_share(results[m], truth) for m in BOTH}
        return fewer(wrong, "is wrong in")
    if truth is not None:
        return fewer_steps(order_shares(truth, boundary))
    if both and REFERENCE in results:
        return nearer(results)
    missing = [METHODS[m].label for m in (*BOTH, REFERENCE) if m not in results]
    needed = " and ".join(missing)
    return (
        f"Which of T/A and A/T suits better can't be told yet: run {needed} too, since the one "
        f"that is nearer to {reference} is the better one."
    )


def nearer(results: Mapping[str, xr.DataArray]) -> str:
    """Say which of T/A and A/T differs from the result of directional L1 in fewer pixels."""
    shares = {m: float((turns_off(results[m], results[REFERENCE]) != 0).mean()) for m in BOTH}
    return fewer(shares, f"differs from {METHODS[REFERENCE].label} in")


def fewer(shares: Mapping[str, float], does: str) -> str:
    """Say which of the two does it in fewer of the pixels, or that it makes no difference."""
    first, second = sorted(BOTH, key=lambda m: shares[m])
    labels, percent = (
        (METHODS[first].label, METHODS[second].label),
        [f"{100 * shares[m]:.2g} %" for m in (first, second)],
    )
    if alike(shares[first], shares[second]):
        return (
            f"T/A or A/T makes no difference: {labels[0]} {does} {percent[0]} of the pixels, "
            f"{labels[1]} in {percent[1]}."
        )
    return (
        f"{labels[0]} suits better: it {does} {percent[0]} of the pixels, "
        f"{labels[1]} in {percent[1]}."
    )


def fewer_steps(shares: Mapping[str, float]) -> str:
    """Say which of the two meets fewer steps beyond half a cycle in the exact phase."""
    first, second = sorted(BOTH, key=lambda m: shares[m])
    if alike(shares[first], shares[second]):
        return "T/A and A/T meet equally many, by the exact phase."
    return f"{METHODS[first].label} meets fewer of them, by the exact phase."


def alike(less: float, more: float) -> bool:
    """Say whether two shares of all pixels are about the same."""
    return more - less < max(LEAST_SHARE, LEAST_PART * more)
