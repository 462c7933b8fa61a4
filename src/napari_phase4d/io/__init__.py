"""Readers and writers, one module per file family."""

from napari_phase4d.io.arriving import Arrival, ArrivedFrames, Arriving
from napari_phase4d.io.camera import FromCamera
from napari_phase4d.io.describing import OME_TIFF, OME_ZARR, PROGRAM, step_of
from napari_phase4d.io.growing import arriving_at
from napari_phase4d.io.movies import check_figure, write_figure, write_movie
from napari_phase4d.io.opening import (
    JOINED_SUFFIXES,
    READABLE_SUFFIXES,
    open_input,
    open_recording,
    recording_of,
)
from napari_phase4d.io.phases import file_pixel_um, holds_phase, open_phase, open_truth
from napari_phase4d.io.raw import RAW_SUFFIXES, RawLayout
from napari_phase4d.io.reading import needs_layout, parts_beside
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.results import read_results, write_phase, write_table
from napari_phase4d.io.tomography import sinogram, write_sinogram

__all__ = [
    "JOINED_SUFFIXES",
    "OME_TIFF",
    "OME_ZARR",
    "PROGRAM",
    "RAW_SUFFIXES",
    "READABLE_SUFFIXES",
    "Arrival",
    "ArrivedFrames",
    "Arriving",
    "FromCamera",
    "RawLayout",
    "address_of",
    "arriving_at",
    "check_figure",
    "file_pixel_um",
    "holds_phase",
    "needs_layout",
    "open_input",
    "open_phase",
    "open_recording",
    "open_truth",
    "parts_beside",
    "read_results",
    "recording_of",
    "sinogram",
    "step_of",
    "write_figure",
    "write_movie",
    "write_phase",
    "write_sinogram",
    "write_table",
]
