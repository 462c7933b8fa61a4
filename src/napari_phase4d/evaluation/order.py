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

    Where the truth is known, the one that is right in more pixels; where the result of directional
    L1 is, the one that is nearer to it; else the one that meets fewer steps beyond half a cycle.

    A result of T/A looks smooth along the angle, because its last pass made it so, and one of A/T
    along time. Without exact phase, a verdict is therefore given only where both agree on it.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of some methods.
    boundary : tuple of int, optional
        The optically thin frame (time, angle).
    truth : DataArray, optional
        Exact phase, where it is known.
    """
    if truth is None and not all(method in results for method in BOTH):
        return "Run T/A and A/T to see which suits better."
    if all(method in results for method in BOTH):
        if truth is not None:
            wrong = {m: wrong_cycle_share(results[m], truth) for m in BOTH}
            return fewer(wrong, "is wrong in", "T/A and A/T are equally right.")
        if REFERENCE in results:
            return nearer(results)
    stacks = [results[method] for method in BOTH] if truth is None else [truth]
    shares = [order_shares(stack, boundary) for stack in stacks]
    verdicts = {min(s, key=lambda m: s[m]) if len(set(s.values())) > 1 else "" for s in shares}
    if verdicts == {""}:
        return "T/A and A/T meet equally many."
    if len(verdicts) > 1:
        return "Which of T/A and A/T suits better can't be told: each favours itself."
    basis = "by the exact phase" if truth is not None else "by the results of both"
    return f"{METHODS[verdicts.pop()].label} meets fewer of them, {basis}."


def nearer(results: Mapping[str, xr.DataArray]) -> str:
    """Say which of T/A and A/T differs from the result of directional L1 in fewer pixels."""
    shares = {m: float((turns_off(results[m], results[REFERENCE]) != 0).mean()) for m in BOTH}
    reference = METHODS[REFERENCE].label
    equal = f"T/A and A/T are equally near to {reference}."
    return fewer(shares, f"differs from {reference} in", equal)


def fewer(shares: Mapping[str, float], does: str, equal: str) -> str:
    """Say which of the two does it in fewer of the pixels."""
    first, second = sorted(BOTH, key=lambda m: shares[m])
    if shares[first] == shares[second]:
        return equal
    return (
        f"{METHODS[first].label} suits better: it {does} {100 * shares[first]:.2g} % of the "
        f"pixels, {METHODS[second].label} in {100 * shares[second]:.2g} %."
    )
