"""Readers and writers, one module per file family."""

from napari_phase4d.io.opening import READABLE_SUFFIXES, open_recording
from napari_phase4d.io.results import read_results, write_phase, write_table

__all__ = ["READABLE_SUFFIXES", "open_recording", "read_results", "write_phase", "write_table"]
