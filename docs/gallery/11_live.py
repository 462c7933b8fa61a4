"""
Phase while one records
=======================

A camera writes one file a frame into a folder; each frame is unwrapped as soon as it is there, by
methods that need nothing but the past. Here a thread plays the camera.
"""

import tempfile
import threading
import time
from pathlib import Path

import matplotlib.pyplot as plt
import tifffile

import napari_phase4d as p4d
from napari_phase4d.pipeline import watch

N, RATE = 40, 20
exact = p4d.simulation.swimming_euglena((256, 256), N, peak_rad=7, pixel_um=0.19)
frames = p4d.simulation.multiplexed_video(exact["phase"]).holograms.values
folder = Path(tempfile.mkdtemp())
camera = folder / "camera"
camera.mkdir()
written: dict[int, float] = {}


def record() -> None:
    """Write the frames, as a camera does."""
    for number, frame in enumerate(frames):
        time.sleep(1 / RATE)
        tifffile.imwrite(camera / f"frame_{number:04}.tif", frame)
        written[number] = time.monotonic()


# %%
# `watch` calls back after each frame. It ends after so many frames, when nothing new has come for
# a while, or when it is told to.

late: dict[int, float] = {}
shown = []


def arrived(index, results):
    """Note how late a frame is, and keep some of its phase."""
    late[index] = time.monotonic() - written[index]
    if index % 13 == 0:
        shown.append((index, results["temporal-angular"][0].copy()))


recipe = p4d.Recipe(angles_deg=(-7, 21), methods=("temporal-angular",))
player = threading.Thread(target=record)
player.start()
outcome = watch(camera, recipe, folder / "live", frames=N, arrived=arrived)
player.join()
print(f"the last frame was there {1000 * late[N - 1]:.0f} ms after its file")

# %%
# Lobes and background are settled on the first 8 frames, which are waited for; then it catches up.

fig, (delay, *pictures) = plt.subplots(1, 1 + len(shown), figsize=(12, 3), layout="constrained")
delay.plot(list(late), [1000 * s for s in late.values()], ".-")
delay.set(xlabel="frame", ylabel="late (ms)", ylim=(0, None))
for axis, (index, phase) in zip(pictures, shown, strict=True):
    picture = axis.imshow(phase, vmin=0, vmax=7, cmap="inferno")
    axis.set(title=f"frame {index}", xticks=[], yticks=[])
fig.colorbar(picture, ax=pictures, label="phase (rad)")

# %%
# A run of the finished recording, with the recipe that was written, gives the same numbers.

again = p4d.run(p4d.Recipe.from_file(folder / "live" / "recipe.json"))
same = again.comparison.results["temporal-angular"].equals(
    outcome.comparison.results["temporal-angular"].load()
)
print("the same numbers:", same)
