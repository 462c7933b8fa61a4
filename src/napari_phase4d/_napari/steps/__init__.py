"""The five steps of the dock, one module each."""

from napari_phase4d._napari.steps.compare import CompareStep
from napari_phase4d._napari.steps.lobes import LobesStep
from napari_phase4d._napari.steps.phase import PhaseStep
from napari_phase4d._napari.steps.recording import RecordingStep
from napari_phase4d._napari.steps.unwrap import UnwrapStep

__all__ = ["CompareStep", "LobesStep", "PhaseStep", "RecordingStep", "UnwrapStep"]
