"""
A recording larger than memory
==============================

What does not fit into memory is worked on a few frames at a time, and lies on disk as OME-Zarr.
That happens by itself; ``storage="disk"`` asks for it, so that a small recording can show it.
The numbers are the same to the last bit.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.pipeline import write_outcome

exact = p4d.simulation.swimming_euglena((200, 200), 32, peak_rad=7, pixel_um=0.24)
video = p4d.simulation.multiplexed_video(exact["phase"])
recipe = p4d.Recipe(angles_deg=(-7, 21), methods=("temporal-angular",))

# %%
# The same run, once on disk and once in memory. `write_outcome` to the same folder leaves the
# stacks where they are.

folder = Path(tempfile.mkdtemp())
on_disk = p4d.run(recipe.changed(storage="disk"), video, folder=folder)
write_outcome(on_disk, folder, form="zarr")
in_memory = p4d.run(recipe.changed(storage="memory"), video)
print(sorted(path.name for path in folder.iterdir()))

# %%
# A stack on disk is opened in no time; a frame is read when it is looked at.

stack = p4d.read_results(folder / "temporal-angular.ome.zarr")
print(type(stack.data).__name__, stack.shape)
same = np.array_equal(stack.values, in_memory.comparison.results["temporal-angular"].values)
print("the same numbers:", same)

# %%
fig, axes = plt.subplots(2, 5, figsize=(11, 4.2), layout="constrained")
for column, time in enumerate(np.linspace(0, stack.sizes["time"] - 1, 5).astype(int)):
    for row, angle in enumerate(stack["angle"].values):
        frame = stack.isel(time=time).sel(angle=angle)
        picture = axes[row, column].imshow(frame, vmin=0, vmax=7, cmap="turbo")
        axes[row, column].set_title(f"{angle:g}°, {float(frame['time']):.1f} s", fontsize=9)
        axes[row, column].set_axis_off()
fig.colorbar(picture, ax=axes, label="phase (rad)")
