"""Whether a dense object comes out bright or dark in a lobe: it or its conjugate is the view.

The intensity is the same when all beams are conjugated, so that only the object can tell: a cell
is denser than water. Two clues are added, each the better one where the other fails:

* a small cell on an empty field gives a skewed histogram of unwrapped phase, its tail on the
  cell's side;
* a cell that fills the field lies higher than the border of the field, where it thins out.

Where the border stands out about as far as what is inside, it is no empty field: it cuts through
the walls of a channel, or a layer of cells. From those, neither clue is more than a guess.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
import skimage
from numpy.typing import NDArray

from napari_phase4d.holography.background import Surface
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.emptyfield import wrapped
from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.holography.surfaces import lit_part, lit_pixels

__all__ = ["evidence_of", "sign_doubts", "sign_evidence", "together"]

#: Odds (their logarithm) of the sign beyond which it is sure: 0.95.
SURE_SIGN = math.log(0.95 / 0.05)
#: The border that is compared with the whole, in pixels.
BORDER = 3
#: A field less than this across shows no more of an object than its border, in pixels.
SMALLEST_SIDE = 5
#: Its sign is a guess.
NOT_ASKED = 1e-9
#: Of larger fields the inner part of the lobe is looked at, about so many pixels of the spectrum
#: across: signs need no detail.
LARGEST_SIDE = 112
#: What the clues add to the logarithm of the odds that dense is bright: skewness, and the height
#: over the border in radians (arsinh of twice it) before and after curvature has been taken off.
#: Fitted to random cells of 1.5 to 16 rad that cover 3 to 97 % of the field.
SKEWNESS, HEIGHT, FLAT_HEIGHT = 0.5, 1.45, 1.5
#: Where the clues of small and of large cells disagree, the small one's is taken if this share of
#: the field is within so many radians of its median; in any case it is a guess, which counts no
#: more than this.
MOSTLY_EMPTY, FLAT_RAD, GUESS = 0.6, 0.8, 2.5
#: A border is no empty field if its middle half spreads over more than this part of the height
#: over it, and a tenth of it stands out more than this part of what the inside does. Cells that
#: the view cuts off reach the one or the other, walls of a channel and most wounds both.
SPREAD, AT_BORDER = 0.9, 0.6
#: How far something stands out: what this share of the inside, or of the border, does not exceed.
INSIDE_OUT, BORDER_OUT = 0.95, 0.9
#: No more skewness than this counts.
MOST_SKEWNESS = 5.0
#: Phase that deviates less than this from its median (rad, rms) shows no object, unless this
#: share of it deviates by so many radians, and so many times as much as half of it does.
LEAST_PHASE_RAD = 0.17
SPOT_SHARE, SPOT_RAD, SPOT_NOISE = 0.002, 0.4, 6.0

Field = NDArray[np.complex64]


def sign_evidence(frame: NDArray[np.float32], lobe: Lobe) -> float:
    """Return the logarithm of the odds that a dense object comes out bright in this lobe.

    Parameters
    ----------
    frame : ndarray of shape (y, x)
        Grey values.
    lobe : Lobe
        Where to look; not flipped.

    Returns
    -------
    float
        Above 0 if it is bright, below if it is dark; 0 where no object is seen. Next to 0 where
        the field is too small to ask.
    """
    inner = replace(lobe, radius=min(lobe.radius, LARGEST_SIDE / (2 * max(frame.shape))))
    return evidence_of(Demodulator(frame.shape, [inner])(frame)[0])


def evidence_of(field: Field) -> float:
    """Return `sign_evidence` of a field, which may still have its tilt."""
    if min(field.shape) < SMALLEST_SIDE:
        return NOT_ASKED
    fit = Surface("powers", 2, field.shape).fit(field)
    flat = field * np.exp(-1j * fit.surface)
    edge = max(2, min(flat.shape) // 16)
    inner = (slice(edge, -edge), slice(edge, -edge))
    # Where there are no fringes the phase is noise, and may lie far off on either side.
    seen = np.zeros(flat.shape, dtype=bool)
    part = lit_part(field)
    seen[inner] = lit_pixels(field, part)[inner]
    phase = skimage.restoration.unwrap_phase(np.ma.masked_array(np.angle(flat), ~seen))
    phase = np.asarray(phase[seen])
    deviation = phase - np.median(phase)
    scale = float(deviation.std())
    spot = float(np.quantile(np.abs(deviation), 1 - SPOT_SHARE))
    clear = spot > max(SPOT_RAD, SPOT_NOISE * float(np.median(np.abs(deviation))))
    if scale < LEAST_PHASE_RAD and not clear:
        return 0.0
    skewness = float(np.mean(deviation**3)) / scale**3
    small = SKEWNESS * float(np.clip(skewness, -MOST_SKEWNESS, MOST_SKEWNESS))
    lit = part[inner]
    small += FLAT_HEIGHT * float(np.arcsinh(2 * height_over_border(flat[inner], lit).radians))
    height = height_over_border(field[inner], lit)
    large = HEIGHT * float(np.arcsinh(2 * height.radians))
    if small * large >= 0:
        uneven = height.spread > SPREAD and height.at_border > AT_BORDER
        return float(np.clip(small + large, -GUESS, GUESS)) if uneven else small + large
    # A bent field looks like a cell that fills it, and such a cell like a bent field.
    empty = float((np.abs(deviation) < FLAT_RAD).mean())
    total = small if empty > MOSTLY_EMPTY and not fit.doubt else small + large
    return float(np.clip(total, -GUESS, GUESS))


class Height(NamedTuple):
    """Mean unwrapped phase less the median of its border.

    Parameters
    ----------
    radians : float
        It, in radians.
    spread : float
        Interquartile range of the border as a share of it.
    at_border : float
        How far the border stands out on the same side, as a share of how far the inside does.
    """

    radians: float
    spread: float
    at_border: float


def height_over_border(field: Field, lit: NDArray[np.bool_]) -> Height:
    """Return how high the phase of a field's lit parts lies over their border.

    Unwrapped by least squares (Ghiglia & Romero 1994), which no single wrong step throws off,
    after the median slopes have been taken off.
    """
    phase = np.angle(field)
    down, across = (wrapped(np.diff(phase, axis=axis)) for axis in (0, 1))
    for step, seen in ((down, lit[1:] & lit[:-1]), (across, lit[:, 1:] & lit[:, :-1])):
        step -= np.median(step[seen]) if seen.any() else 0
        step[~seen] = 0  # noise, beyond an aperture
    divergence = np.zeros(phase.shape)
    divergence[:-1] += down
    divergence[1:] -= down
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    height, width = (2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in phase.shape)
    eigenvalues = height[:, None] + width[None, :]
    eigenvalues[0, 0] = np.inf  # the mean stays open
    unwrapped = scipy.fft.idctn(
        scipy.fft.dctn(divergence, norm="ortho") / eigenvalues, norm="ortho"
    )
    # A dark object has no border of the view.
    whole = scipy.ndimage.binary_fill_holes(lit)
    border = lit & ~scipy.ndimage.binary_erosion(whole, iterations=BORDER)
    low, middle, high = np.quantile(unwrapped[border], (0.25, 0.5, 0.75))
    height = float(unwrapped[lit].mean() - middle)
    out = (unwrapped - middle) * np.sign(height)
    inside = float(np.quantile(out[lit], INSIDE_OUT))
    at_border = float(np.quantile(out[border], BORDER_OUT))
    if height == 0 or inside <= 0:  # flat, or all that stands out is at the border
        return Height(height, 1.0, 1.0)
    return Height(height, float(high - low) / abs(height), at_border / inside)


def together(evidence: Sequence[float]) -> float:
    """Return what views say that lie on the same side.

    They show the same object, so that several guesses are no more than one.
    """
    guesses = sum(each for each in evidence if abs(each) <= GUESS)
    others = sum(each for each in evidence if abs(each) > GUESS)
    return float(np.clip(guesses, -GUESS, GUESS)) + others


def sign_doubts(evidence: Sequence[float]) -> list[str]:
    """Say of which lobes the sign is a guess."""
    return [
        f"{'Whether' if each else 'No object is seen, so that whether'} a dense object is bright "
        "or dark here is a guess: if cells look like holes, press Flip."
        if abs(each) < SURE_SIGN
        else ""
        for each in evidence
    ]
