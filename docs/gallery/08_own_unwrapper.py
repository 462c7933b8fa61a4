"""
An unwrapper of your own
========================

A method is a function and a few facts about it. `frame_by_frame` makes one for a whole stack out
of a function that unwraps one frame. Here it is the oldest of all: along each row, then along
each column (Itoh 1982). Installed as a package, it has its place in the window and on the
command line: :doc:`/how-to/own_unwrapper`.
"""

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.analysis import mean_squared_error
from napari_phase4d.unwrapping import Method, Problem, frame_by_frame


def row_by_row(wrapped, mask):
    """Unwrap along the middle column, then from there along every row."""
    middle = wrapped.shape[1] // 2
    start = np.unwrap(wrapped[:, middle])
    right = np.unwrap(wrapped[:, middle:], axis=1)
    left = np.unwrap(wrapped[:, middle::-1], axis=1)[:, ::-1]
    found = np.concatenate([left[:, :-1], right], axis=1)
    return found + (start - wrapped[:, middle])[:, None]


method = Method(
    label="Rows",
    source="Itoh 1982, Appl. Opt. 21, 2470",
    summary="Along each row, then along a column.",
    function=frame_by_frame(row_by_row),
)

# %%
# It is given a problem: wrapped phase with its mask and boundary frames. Where noise makes a
# step of half a turn, the rest of the row is off: streaks, which joining the most reliable
# pixels first avoids.

errors, shown = {}, {}
cell = p4d.simulation.swimming_euglena((96, 96), 4, peak_rad=9, pixel_um=0.5)
for noise_rad in (0.0, 0.4, 0.8):
    noisy = p4d.simulation.with_noise(cell, noise_rad)
    problem = Problem(noisy["wrapped"])
    values = method.function(problem, None, None)
    rows = problem.result(values, "rows", {"method": "rows"})
    usual = p4d.unwrap(noisy["wrapped"], "spatial-2d")
    errors[noise_rad] = [mean_squared_error(r, noisy["phase"]) for r in (rows, usual)]
    shown[noise_rad] = (rows[-1, 0], usual[-1, 0])
    print(f"noise {noise_rad}:", "{:.2g} rad² by rows, {:.2g} by 2-D".format(*errors[noise_rad]))

# %%
fig, axes = plt.subplots(2, 3, figsize=(8, 5), layout="constrained")
for column, (noise_rad, pictures) in enumerate(shown.items()):
    for row, (label, frame) in enumerate(zip((method.label, "2-D"), pictures, strict=True)):
        picture = axes[row, column].imshow(frame, vmin=-5, vmax=10, cmap="turbo")
        axes[row, column].set_title(f"{label}, noise {noise_rad} rad", fontsize=10)
        axes[row, column].set_axis_off()
fig.colorbar(picture, ax=axes, label="phase (rad)")
