"""
Steps of many turns, by two wavelengths
=======================================

A sheer step of more than half a wavelength can't be told from a smaller one: phase comes back
every turn, and no way round leads by a slope. Two wavelengths in one hologram tell it, up to half
their synthetic wavelength.
"""

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.simulation import at_wavelengths, step_phantom, with_noise

# Walls of 0.25 to 5 µm.
plates = step_phantom(paths_um=(0.25, 0.5, 1, 2, 3, 5), n_times=1)
exact = with_noise(at_wavelengths(plates, (0.532, 0.561)), 0.02, seed=0)
found = p4d.compare(exact["wrapped"], ["directional-l1", "synthetic-wavelength"])
wavelengths = exact["phase"]["wavelength"].values
print(f"synthetic wavelength {np.prod(wavelengths) / np.ptp(wavelengths):.1f} µm")

# %%
# What the methods make of the steps, as optical path. One wavelength gives steps of less than half
# a wave, wherever the true ones are.

TO_PATH = float(wavelengths[0]) / (2 * np.pi)
fig, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
columns = {"exact": exact["phase"], **found.results}
for axis, (name, stack) in zip(axes, columns.items(), strict=True):
    label = p4d.METHODS[name].label if name in p4d.METHODS else name
    picture = axis.imshow(stack[0, 0] * TO_PATH, cmap="inferno")
    axis.set(title=label, xticks=[], yticks=[])
    fig.colorbar(picture, ax=axis, label="optical path (µm)")

# %%
fig, axis = plt.subplots(figsize=(7, 4), layout="constrained")
row = exact.sizes["y"] // 3
for name, style in (("directional-l1", "C1-"), ("synthetic-wavelength", "C0-")):
    line = found.results[name][0, 0, row] * TO_PATH
    axis.plot(line["x"], line, style, label=p4d.METHODS[name].label)
axis.plot(exact["x"], exact["phase"][0, 0, row] * TO_PATH, "k--", label="exact")
axis.set(xlabel="x (µm)", ylabel="optical path (µm)", title="One row of the steps")
axis.legend()
