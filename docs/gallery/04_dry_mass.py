"""
Dry mass over time
==================

Phase tells how much dry matter a cell holds: dry mass = optical path, summed over the cell,
divided by the refraction increment (0.18 µm³/pg, Barer 1952). Here a cell swells; what is wrong
by a turn is wrong in mass too.
"""

import matplotlib.pyplot as plt

import napari_phase4d as p4d
from napari_phase4d.analysis import measure

optics = p4d.Optics()
cell = p4d.simulation.moving_shape("swelling", (64, 64), 24, optics=optics)
comparison = p4d.compare(
    cell["wrapped"], ["spatial-2d", "temporal-angular"], boundary=(0, 0), mask="auto"
)
regions = {"cell": cell["phase"].values > 0.5}

# %%
# `measure` gives one row for each region, time and angle.

tables = {
    label: measure(stack, regions, optics)
    for label, stack in {
        "exact": cell["phase"],
        "2-D": comparison.results["spatial-2d"],
        "T/A": comparison.results["temporal-angular"],
    }.items()
}
print(tables["T/A"].head(3).T)

# %%
fig, axis = plt.subplots(figsize=(7, 4), layout="constrained")
angle = cell["angle"].values[-1]
for label, style in (("2-D", "C1.-"), ("T/A", "C0o-"), ("exact", "k--")):
    table = tables[label]
    there = table[table["angle (deg)"] == angle]
    axis.plot(there["time (s)"], there["dry mass (pg)"], style, label=label, mfc="none")
axis.set(xlabel="time (s)", ylabel="dry mass (pg)", title=f"A swelling cell, seen at {angle:g}°")
axis.legend()
