"""
Out of focus, through bad optics
================================

A hologram holds the whole light wave, so that what was recorded out of focus can be brought into
focus, and a smooth error of the optics taken off, afterwards.
"""

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.holography import autofocus, propagate

# %%
# A cell of 3 radians, carried 25 µm out of focus before the camera sees it, and a reference wave
# that is bent by 12 radians at the corners of the frame.

optics = p4d.Optics(magnification=40)
exact = p4d.simulation.swimming_euglena((240, 240), 1, peak_rad=3, angles_deg=(-7,), optics=optics)
light = (optics.wavelength_um, optics.pixel_um, optics.medium_index)
wave = propagate(np.exp(1j * exact["phase"].values[0, 0]), 25.0, *light)
y, x = np.mgrid[-1:1:240j, -1:1:240j]
bent = 12 * (x**2 + y**2) / 2
carrier = 2 * np.pi * (0.2 * np.arange(240)[:, None] + 0.225 * np.arange(240)[None, :])
hologram = np.abs(1.5 * np.exp(-1j * bent) + wave * np.exp(1j * carrier)) ** 2
rec = p4d.open_recording((hologram / hologram.max() * 250).astype(np.uint8), optics)

# %%
# As it comes; with the bend taken off; and in focus as well. "curvature" is fitted to the empty
# field.

lobes = p4d.find_lobes(rec, n_views=1)
steps = {
    "as recorded": p4d.reconstruct(rec, lobes, background="tilt"),
    "without the bend": p4d.reconstruct(rec, lobes, background="curvature"),
    "and in focus": p4d.reconstruct(rec, lobes, background="curvature", refocus_um="auto"),
}
found_um = steps["and in focus"].attrs["refocus_um"]
print(f"refocused by {found_um:.1f} µm")

# %%
field = steps["without the bend"]
values = field["amplitude"].values[0, 0] * np.exp(1j * field["phase"].values[0, 0])
pixel = float(field["x"][1] - field["x"][0])
focus = autofocus(values, optics.wavelength_um, pixel, optics.medium_index, span_um=60)

brightest = float(steps["as recorded"]["amplitude"].max())
fig, axes = plt.subplots(2, 4, figsize=(12, 5.4), layout="constrained")
for column, (title, data) in enumerate(steps.items()):
    axes[0, column].imshow(data["amplitude"][0, 0], cmap="gray", vmin=0, vmax=brightest)
    axes[0, column].set_title(f"amplitude, {title}", fontsize=10)
    picture = axes[1, column].imshow(data["phase"][0, 0], cmap="twilight", vmin=-np.pi, vmax=np.pi)
    axes[1, column].set_title(f"phase, {title}", fontsize=10)
fig.colorbar(picture, ax=axes[1, 2], label="wrapped phase (rad)")
axes[0, 3].plot(focus.scores["distance"], focus.scores)
axes[0, 3].axvline(focus.distance_um, color="C3", ls="--")
axes[0, 3].set(xlabel="distance (µm)", title="measure of focus", yticks=[])
for axis in (*axes[:, :3].flat, axes[1, 3]):
    axis.set_axis_off()
