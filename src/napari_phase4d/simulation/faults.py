"""What goes wrong while a recording is made, done to simulated phase whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.simulation.ellipsoids import wrap
from napari_phase4d.words import advised_call, check_finite, shown

__all__ = ["FAULTS", "with_fault", "with_noise"]

Stack = NDArray[np.float32]
Random = np.random.Generator


def ramp(shape: tuple[int, ...], rise: float) -> Stack:
    """Return a plane over y and x that rises by so many radians from corner to corner."""
    y, x = np.linspace(-0.5, 0.5, shape[-2]), np.linspace(-0.5, 0.5, shape[-1])
    return (rise * 0.5 * (y[:, None] - x[None, :])).astype(np.float32)


def kicked(exact: Stack, half: int, rng: Random) -> Stack:
    """Move the field by some pixels from one frame to the next."""
    found = exact.copy()
    found[half:] = np.roll(found[half:], (4, -6), axis=(2, 3))
    return found


def levelled_anew(exact: Stack, half: int, rng: Random) -> Stack:
    """Change level and tilt from one frame to the next."""
    found = exact.copy()
    found[half:] += np.float32(2.4) + ramp(exact.shape, 1.5)
    return found


def tilted(exact: Stack, half: int, rng: Random) -> Stack:
    """Tilt every frame in a way of its own."""
    rises = rng.uniform(-1.2, 1.2, exact.shape[:2])
    return exact + np.stack([[ramp(exact.shape, r) for r in row] for row in rises])


def off_level(exact: Stack, half: int, rng: Random) -> Stack:
    """Give every frame a level of its own."""
    return exact + rng.uniform(-3, 3, exact.shape[:2])[..., None, None].astype(np.float32)


def doubled(exact: Stack, half: int, rng: Random) -> Stack:
    """Double the phase from one frame to the next."""
    found = exact.copy()
    found[half:] *= 2
    return found


def paused(exact: Stack, half: int, rng: Random) -> Stack:
    """Leave out half of the recording."""
    return exact[beside_pause(len(exact))]


def beside_pause(n: int) -> NDArray[np.intp]:
    """Return the numbers of the frames before and after the pause, of n."""
    return np.concatenate([np.arange(max(n // 5, 1)), np.arange(n - n // 3, n)])


#: Name -> what changes the exact phase.
OF_PHASE: Mapping[str, Callable[[Stack, int, Random], Stack]] = MappingProxyType(
    {
        "kick": kicked,
        "jump of level": levelled_anew,
        "tilt per frame": tilted,
        "level per frame": off_level,
        "doubling": doubled,
        "pause": paused,
    }
)


def black(wrapped: Stack, half: int, rng: Random) -> None:
    """Make one frame zero."""
    wrapped[half] = 0


def constant(wrapped: Stack, half: int, rng: Random) -> None:
    """Give one frame the same phase everywhere, as a saturated camera does."""
    wrapped[half] = 1.3


def noise_only(wrapped: Stack, half: int, rng: Random) -> None:
    """Leave nothing but noise in one frame."""
    wrapped[half] = rng.uniform(-np.pi, np.pi, wrapped[half].shape)


def one_view_black(wrapped: Stack, half: int, rng: Random) -> None:
    """Make one view of one frame zero."""
    wrapped[half, -1] = 0


def one_view_noise(wrapped: Stack, half: int, rng: Random) -> None:
    """Leave nothing but noise in one view of one frame."""
    wrapped[half, -1] = rng.uniform(-np.pi, np.pi, wrapped[half, -1].shape)


def two_black(wrapped: Stack, half: int, rng: Random) -> None:
    """Make two frames in a row zero."""
    wrapped[half : half + 2] = 0


def dead_pixels(wrapped: Stack, half: int, rng: Random) -> None:
    """Let one pixel in a hundred show noise at all times."""
    dead = rng.random(wrapped.shape[-2:]) < 0.01
    wrapped[..., dead] = rng.uniform(-np.pi, np.pi, (*wrapped.shape[:2], int(dead.sum())))


def hot_pixels(wrapped: Stack, half: int, rng: Random) -> None:
    """Let one pixel in a hundred of every frame show noise."""
    dead = rng.random(wrapped.shape) < 0.01
    wrapped[dead] = rng.uniform(-np.pi, np.pi, int(dead.sum()))


#: Name -> what changes the wrapped phase in place; what it shows then is not the object.
OF_CAMERA: Mapping[str, Callable[[Stack, int, Random], None]] = MappingProxyType(
    {
        "black frame": black,
        "constant frame": constant,
        "noise-only frame": noise_only,
        "black view": one_view_black,
        "noise-only view": one_view_noise,
        "two black frames": two_black,
        "dead pixels": dead_pixels,
        "hot pixels": hot_pixels,
    }
)
#: All faults by name.
FAULTS = (*OF_PHASE, *OF_CAMERA)


@advised_call(data='give one with "phase", as budding_yeast() does')
def with_fault(data: xr.Dataset, fault: str, noise_rad: float = 0.0, seed: int = 0) -> xr.Dataset:
    """Let something go wrong half way through a recording, and add noise.

    Parameters
    ----------
    data : Dataset
        With exact ``phase``, dims (time, angle, y, x).
    fault : str
        One of `FAULTS`.
    noise_rad : float, optional
        Standard deviation in radians of white noise on every pixel.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    Dataset
        ``phase`` is what an unwrapper that is right everywhere returns: the exact phase with the
        fault and the noise, NaN where the camera showed something else. ``wrapped`` is what is
        seen.

    Raises
    ------
    ValueError
        If there is no such fault.
    """
    if fault not in FAULTS:
        msg = f"fault must be one of {', '.join(FAULTS)}, but is {shown(fault)}"
        raise ValueError(msg)
    rng = np.random.default_rng(seed)
    if "phase" not in data or check_finite("noise_rad", noise_rad) < 0 or seed < 0:
        msg = 'data must hold the exact "phase", and noise_rad and seed must be 0 or more'
        raise ValueError(msg)
    exact: Stack = data["phase"].values
    half = len(exact) // 2
    if fault in OF_PHASE:
        exact = OF_PHASE[fault](exact, half, rng)
    exact = exact + noise_rad * rng.normal(0, 1, exact.shape).astype(np.float32)
    kept = data["phase"]
    if fault == "pause":  # of the frames after it the times are later ones
        kept = kept.isel(time=beside_pause(len(kept)))
    truth = kept.copy(data=exact.astype(np.float32))
    wrapped = wrap(truth)
    if fault in OF_CAMERA:
        # What it changes, also where that was the same number before.
        changed = np.full(wrapped.shape, np.nan, dtype=np.float32)
        OF_CAMERA[fault](changed, half, deepcopy(rng))
        OF_CAMERA[fault](wrapped.values, half, rng)
        truth = truth.where(np.isnan(changed))
    wrapped.attrs = dict(data["wrapped"].attrs) if "wrapped" in data else {}
    return xr.Dataset({"phase": truth, "wrapped": wrapped}, attrs=data.attrs)


@advised_call(data='give one with "phase", as budding_yeast() does')
def with_noise(
    data: xr.Dataset, noise_rad: float = 0.0, drift_rad: float = 0.0, seed: int = 0
) -> xr.Dataset:
    """Add noise and drift to exact phase, and wrap it anew.

    Parameters
    ----------
    data : Dataset
        With exact ``phase``.
    noise_rad : float, optional
        Standard deviation in radians of white noise on every pixel.
    drift_rad : float, optional
        Standard deviation in radians of the change of each view's level from frame to frame.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    xarray.Dataset
        ``phase`` is the exact phase with the same noise and drift, so that an unwrapper that is
        right everywhere leaves no error; ``wrapped`` belongs to it.
    """
    if "phase" not in data:
        msg = f'data holds {", ".join(map(str, data)) or "nothing"}, but no exact "phase"'
        raise ValueError(msg)
    for name, value in (("noise_rad", noise_rad), ("drift_rad", drift_rad), ("seed", seed)):
        if check_finite(name, value) < 0:
            msg = f"{name} must be 0 or more, but is {value}"
            raise ValueError(msg)
    rng = np.random.default_rng(seed)
    exact = data["phase"]
    values = exact.values + rng.normal(0, 1, exact.shape).astype(np.float32) * np.float32(
        noise_rad
    )
    steps = rng.normal(0, drift_rad, exact.shape[:2])
    steps[0] = 0
    drift = np.cumsum(steps, axis=0).astype(np.float32)
    noisy = exact.copy(data=values + drift[:, :, None, None])
    wrapped = wrap(noisy)
    wrapped.attrs = dict(data["wrapped"].attrs) if "wrapped" in data else {}
    return xr.Dataset({"phase": noisy, "wrapped": wrapped}, attrs=data.attrs)
