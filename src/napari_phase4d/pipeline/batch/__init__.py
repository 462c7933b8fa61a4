"""Many files by one recipe, unattended: each gets a folder that is complete or not there."""

from napari_phase4d.pipeline.batch.folders import result_folders
from napari_phase4d.pipeline.batch.running import run_batch

__all__ = ["result_folders", "run_batch"]
