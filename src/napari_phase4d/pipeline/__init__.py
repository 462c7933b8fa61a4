"""The one path behind the window, scripts and the command line.

A `Recipe` holds every setting; `run` follows it from the recording to the unwrapped phase.
"""

from napari_phase4d.pipeline.ahead import (
    estimated_seconds,
    load_object_finder,
    warm_up_elsewhere,
)
from napari_phase4d.pipeline.batch import run_batch
from napari_phase4d.pipeline.batch_folders import result_folders
from napari_phase4d.pipeline.feed import LiveStatus
from napari_phase4d.pipeline.folder import checked_form, holds_outcome, read_outcome, write_files
from napari_phase4d.pipeline.guarding import result_folder, write_outcome
from napari_phase4d.pipeline.live import shown_method, watch
from napari_phase4d.pipeline.places import (
    Needs,
    Place,
    find_place,
    make_folder,
    needed_bytes,
    needs_of,
    phase_needs,
    stacks_beside,
    working_bytes,
)
from napari_phase4d.pipeline.provenance import (
    Fingerprint,
    fingerprint,
    fingerprinting,
    program_version,
    source_of,
)
from napari_phase4d.pipeline.recipe import DEFAULT_METHODS, PAPER_METHODS, PHASE_SETTINGS, Recipe
from napari_phase4d.pipeline.running import (
    Outcome,
    advice_on,
    focus_by,
    reconstruct_by,
    run,
    run_unwarned,
    unwrap_by,
)
from napari_phase4d.pipeline.starting import (
    FOUND_BY,
    found_anywhere,
    light_for,
    lobes_of,
    noting_start,
    open_by,
    start_sentence,
    start_words,
    typed_into,
    what_needs_holograms,
    with_start,
    without_holograms,
)
from napari_phase4d.words import EXPECTED, sentence_of, size_in_words, time_in_words

__all__ = [
    "DEFAULT_METHODS",
    "EXPECTED",
    "FOUND_BY",
    "PAPER_METHODS",
    "PHASE_SETTINGS",
    "Fingerprint",
    "LiveStatus",
    "Needs",
    "Outcome",
    "Place",
    "Recipe",
    "advice_on",
    "checked_form",
    "estimated_seconds",
    "find_place",
    "fingerprint",
    "fingerprinting",
    "focus_by",
    "found_anywhere",
    "holds_outcome",
    "light_for",
    "load_object_finder",
    "lobes_of",
    "make_folder",
    "needed_bytes",
    "needs_of",
    "noting_start",
    "open_by",
    "phase_needs",
    "program_version",
    "read_outcome",
    "reconstruct_by",
    "result_folder",
    "result_folders",
    "run",
    "run_batch",
    "run_unwarned",
    "sentence_of",
    "shown_method",
    "size_in_words",
    "source_of",
    "stacks_beside",
    "start_sentence",
    "start_words",
    "time_in_words",
    "typed_into",
    "unwrap_by",
    "warm_up_elsewhere",
    "watch",
    "what_needs_holograms",
    "with_start",
    "without_holograms",
    "working_bytes",
    "write_files",
    "write_outcome",
]
