"""
One curve for each cell
=======================

Several cells swim through the field, touch, divide, leave and come in. `find_cells` finds each of
them and follows it through time and views; `measure` weighs it in every frame, with an error bar.
The recording is simulated, so that the mass of each cell is known.
"""

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.plotting import colour_of

optics = p4d.Optics()
sample = p4d.simulation.swimming_cells((128, 160), 24, 4, entering=0)
noisy = p4d.simulation.with_noise(sample, 0.1, seed=0)
unwrapped = p4d.unwrap(noisy["wrapped"], "directional-l1")
cells = p4d.find_cells(unwrapped)
table = p4d.measure(unwrapped, cells, optics)
print(table[["cell", "time (s)", "angle (deg)", "dry mass (pg)", "dry mass error (pg)"]].head())

# %%
# The same cell has the same number and colour in every frame and view.

fig, axes = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
for axis, frame in zip(axes, (0, 12, 23), strict=True):
    axis.imshow(unwrapped[frame, 0], cmap="gray")
    for number in np.unique(cells[frame, 0]):
        if number:
            outline = cells[frame, 0] == number
            axis.contour(outline, [0.5], colors=[colour_of(int(number))])
    axis.set(title=f"{float(unwrapped['time'][frame]):.1f} s", xticks=[], yticks=[])

# %%
# The dry mass of each cell, in one view. The band is the error, one standard deviation.

fig, axis = plt.subplots(figsize=(8, 4), layout="constrained")
angle = table["angle (deg)"].min()
for number, rows in table[table["angle (deg)"] == angle].groupby("cell"):
    mass, error = rows["dry mass (pg)"], rows["dry mass error (pg)"]
    colour = colour_of(int(number))
    axis.plot(rows["time (s)"], mass, color=colour, label=f"cell {number}")
    axis.fill_between(rows["time (s)"], mass - error, mass + error, color=colour, alpha=0.3)
axis.set(xlabel="time (s)", ylabel="dry mass (pg)", title="Cells that swim and divide")
axis.legend(ncols=2)
