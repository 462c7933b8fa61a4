"""
Choosing the frame to start from
================================

T/A and A/T follow the phase from one frame that two-dimensional unwrapping gets right: an
optically thin one. `score_boundaries` looks for it, without knowing the exact phase. What goes
wrong with a thick one?
"""

import matplotlib.pyplot as plt
import numpy as np

import napari_phase4d as p4d
from napari_phase4d.analysis import mean_squared_error

cell = p4d.simulation.moving_shape("vacuole", (64, 64), 20)
scores = p4d.score_boundaries(cell["wrapped"])
best = tuple(scores.attrs["best"])
worst = tuple(int(i) for i in np.unravel_index(np.argmin(scores.values), scores.shape))
print("best frame (time, angle):", best, "worst:", worst)

# %%
# A score is the share of the object on which that frame alone and all frames together agree.
# Frames near to 1 are safe; from a bad frame, the error is carried to all others.

errors = {}
shown = {}
for name, boundary in (("best", best), ("worst", worst)):
    result = p4d.unwrap(cell["wrapped"], "temporal-angular", boundary=boundary, mask="auto")
    errors[name] = mean_squared_error(result, cell["phase"])
    shown[name] = result
print({name: round(error, 2) for name, error in errors.items()})

# %%
fig, axes = plt.subplots(1, 4, figsize=(12, 3.6), layout="constrained")
chart = axes[0].imshow(scores.T, origin="lower", cmap="RdYlGn", vmin=0, vmax=1, aspect="auto")
fig.colorbar(chart, ax=axes[0], label="score")
for frame, mark in ((best, "*"), (worst, "x")):
    axes[0].plot(*frame, mark, color="black", ms=11)
axes[0].set(title="how safe each frame is", xlabel="time (frame)", ylabel="angle (frame)")
axes[0].set_yticks(range(scores.sizes["angle"]))
stacks = {"exact": cell["phase"]} | {
    f"T/A from the {name} frame\n{errors[name]:.2g} rad²": stack for name, stack in shown.items()
}
off = np.abs(shown["worst"] - cell["phase"]).sum(("y", "x")).values
time, angle = np.unravel_index(np.argmax(off), off.shape)  # where it does most harm
for axis, (title, stack) in zip(axes[1:], stacks.items(), strict=True):
    picture = axis.imshow(
        stack[time, angle], vmin=0, vmax=float(cell["phase"].max()), cmap="turbo"
    )
    axis.set_title(title, fontsize=10)
    axis.set_axis_off()
fig.colorbar(picture, ax=axes[3], label="phase (rad)")
