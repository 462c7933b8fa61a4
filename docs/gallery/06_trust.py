"""
Where to trust a result
=======================

Without exact phase nobody sees which pixels are wrong. Two maps help: `Comparison.confidence`
gives the chance that a pixel has the right number of turns, and `itoh_margin` where steps come
near to half a turn, beyond which no method can follow them. Here both are held against the exact
phase.
"""

from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.analysis import itoh_margin, wrong_cycle_map

yeast = p4d.simulation.budding_yeast()
comparison = p4d.compare(
    yeast["wrapped"], ["temporal-angular", "directional-l1"], boundary=(0, 0), mask="auto"
)
result = comparison.results["temporal-angular"]
trust = comparison.confidence("temporal-angular")
wrong = wrong_cycle_map(result, yeast["phase"])

# %%
# Pixels that are trusted less are wrong more often.

edges = (0.0, 0.1, 0.5, 0.9, 1.01)
for low, high in pairwise(edges):
    there = (trust >= low) & (trust < high)
    count, share = int(there.sum()), 100 * float(wrong.where(there).mean())
    print(f"trust {low:.1f} to {min(high, 1):.1f}: {count:6d} pixels, {share:5.1f} % wrong")

# %%
# The steps are measured on what is most to be relied on, here WL1. Beyond 1, half a turn, a step
# can't be told from one the other way.

margin = itoh_margin(comparison.results["directional-l1"])
for name, steps in margin.items():
    print(f"{name}: {100 * steps.attrs['share_beyond']:.2f} % of the steps are beyond half a turn")

# %%
time, angle = np.unravel_index(np.argmax(wrong.values.sum(axis=(2, 3))), wrong.shape[:2])
fig, axes = plt.subplots(1, 5, figsize=(12, 3.4), layout="constrained")
pictures = {
    "T/A": (result, "turbo", None, "phase (rad)"),
    "truly wrong": (wrong, "Reds", 1, "1 = by a turn or more"),
    "trust": (trust, "RdYlGn", 1, "chance of being right"),
    "steps in time": (margin["along_time"], "magma", 2, "half turns"),
    "steps in y": (margin["along_y"], "magma", 2, "half turns"),
}
for axis, (title, (stack, colours, top, unit)) in zip(axes, pictures.items(), strict=True):
    picture = axis.imshow(stack[time, angle], cmap=colours, vmin=0, vmax=top)
    fig.colorbar(picture, ax=axis, label=unit, location="bottom")
    axis.set_title(title, fontsize=10)
    axis.set_axis_off()
