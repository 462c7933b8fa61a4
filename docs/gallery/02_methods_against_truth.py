"""
All methods against the exact phase
===================================

The budding yeast of the paper, simulated: 6 angles, 19 times, steps beyond half a turn at its
rims. `compare` runs every method on it and puts the errors into a table.
"""

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.unwrapping import BUILT_IN

yeast = p4d.simulation.budding_yeast()
comparison = p4d.compare(
    yeast["wrapped"],
    [method for method, facts in BUILT_IN.items() if facts.wavelengths == 1],
    boundary=(0, 0),
    truth=yeast["phase"],
    mask="auto",
)
print(comparison.table[["method", "mse_rad2", "wrong_cycles_percent"]].round(3))

# %%
# The last time at the largest angle is the frame farthest from the thin one. Where a result is
# off by whole turns, it is off in patches.

results = {"exact": yeast["phase"], **comparison.results}
names = ["exact", *comparison.table["method"]]
fig, axes = plt.subplots(2, 7, figsize=(12, 4.2), layout="constrained")
for axis, name, result in zip(axes.flat, names, results.values(), strict=False):
    picture = axis.imshow(result[-1, -1], vmin=0, vmax=float(yeast["phase"].max()), cmap="turbo")
    error = float(((result - yeast["phase"]) ** 2).mean())
    axis.set_title(name if name == "exact" else f"{name}\n{error:.2g} rad²", fontsize=9)
for axis in axes.flat:
    axis.set_axis_off()
fig.colorbar(picture, cax=axes[1, 6].inset_axes((0.1, 0, 0.12, 1)), label="phase (rad)")

# %%
# An error is not spread evenly. Over all frames, the share of pixels that are wrong by a turn or
# more:

wrong = {
    name: np.mean(np.round((r - yeast["phase"]) / (2 * np.pi)).values != 0)
    for name, r in zip(names[1:], comparison.results.values(), strict=True)
}
print({name: f"{100 * share:.2f} %" for name, share in wrong.items()})
