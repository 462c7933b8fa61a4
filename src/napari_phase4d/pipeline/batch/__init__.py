"""Many files by one recipe, unattended: each gets a folder that is complete or not there."""

from napari_phase4d.pipeline.batch.folders import result_folders
from napari_phase4d.pipeline.batch.running import make_folder, run_batch
from napari_phase4d.pipeline.batch.summary import EXPECTED, sentence_of

__all__ = ["EXPECTED", "make_folder", "result_folders", "run_batch", "sentence_of"]
