"""
From a hologram video to unwrapped phase
========================================

Ten lines take a recording to phase over time, angle, y and x. The recording is made up here: a
euglena that turns while it swims, two views in each camera frame. With a file of yours the
second part is the same.
"""

import matplotlib.pyplot as plt

import napari_phase4d as p4d

optics = p4d.Optics(magnification=30)
exact = p4d.simulation.swimming_euglena((300, 300), 24, peak_rad=9, optics=optics)
video = p4d.simulation.multiplexed_video(exact["phase"], optics)

# %%
# `open_recording` takes an array, a file or a folder. Angles can't be told from a hologram: they
# are typed in.

rec = p4d.open_recording(video.holograms, optics, frame_rate_hz=6)
lobes = p4d.find_lobes(rec, n_views=2, angles_deg=(-7, 21))
data = p4d.reconstruct(rec, lobes)
phase = p4d.unwrap(data["phase"], "temporal-angular", boundary=(0, 0), mask="auto")
print(phase.dims, phase.shape)

# %%
# One frame on its way: hologram, spectrum with a circle round each view, wrapped and unwrapped
# phase.

time = -1
spectrum = p4d.power_spectrum(rec)
fig, axes = plt.subplots(2, 3, figsize=(9.5, 6), layout="constrained")
axes[0, 0].imshow(rec.frame(time), cmap="gray")
axes[0, 0].set_title("hologram")
ky, kx = spectrum["ky"].values, spectrum["kx"].values
axes[1, 0].imshow(
    spectrum.clip(min=float(spectrum.median())) ** 0.1,
    extent=(kx[0], kx[-1], ky[-1], ky[0]),
    cmap="gray",
)
for lobe, colour in zip(lobes, ("tab:cyan", "tab:orange"), strict=True):
    circle = plt.Circle(lobe.carrier[::-1], lobe.radius, color=colour, fill=False, lw=2)
    axes[1, 0].add_patch(circle)
axes[1, 0].set_title("spectrum and lobes")
for row, angle in enumerate(phase["angle"].values):
    axes[row, 1].imshow(data["phase"].sel(angle=angle)[time], cmap="twilight")
    axes[row, 1].set_title(f"wrapped, {angle:g}°")
    picture = axes[row, 2].imshow(phase.sel(angle=angle)[time], cmap="turbo", vmin=0, vmax=9)
    axes[row, 2].set_title(f"unwrapped, {angle:g}°")
fig.colorbar(picture, ax=axes[:, 2], label="phase (rad)", shrink=0.9)
for axis in axes.flat:
    axis.set_xticks([])
    axis.set_yticks([])
