"""Unwrapping methods behind one function."""

from napari_phase4d.unwrapping.alone import object_in
from napari_phase4d.unwrapping.boundaries import (
    SCORED_PIXELS,
    SCORED_TIMES,
    SCORING_METHOD,
    best_frame,
    score_boundaries,
    scores_of_some,
    scores_sentence,
)
from napari_phase4d.unwrapping.brought import frame_by_frame
from napari_phase4d.unwrapping.causal import CAUSAL, Causal, causal_methods, for_what_comes
from napari_phase4d.unwrapping.chain import ORDERS
from napari_phase4d.unwrapping.directional.graph import graph_bytes
from napari_phase4d.unwrapping.directional.levels import Residues, level_residues
from napari_phase4d.unwrapping.directional.support import (
    Astray,
    Judged,
    Support,
    astray,
    supports_by_steps,
)
from napari_phase4d.unwrapping.filters import median_of, shrunk
from napari_phase4d.unwrapping.frames import border_medians
from napari_phase4d.unwrapping.given import (
    Given,
    checked_boundaries,
    is_known,
    noise_of,
    working_blocks,
    working_frames,
)
from napari_phase4d.unwrapping.light import ViewsOf, frames_among, views_by_light
from napari_phase4d.unwrapping.light.agreement import odds_by_wavelengths
from napari_phase4d.unwrapping.light.alignment import ViewsApart, views_apart
from napari_phase4d.unwrapping.light.synthetic import all_wavelengths_known
from napari_phase4d.unwrapping.neighbours import both_ends, ends_along
from napari_phase4d.unwrapping.network_flow import loop_sums
from napari_phase4d.unwrapping.objects import left_out_advice
from napari_phase4d.unwrapping.plateaus import (
    every_plateau,
    on_its_field,
    settle_plateaus,
    shown_field,
)
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registry import BUILT_IN, METHODS, STACKS_OF_A_FRAME, Method, Option
from napari_phase4d.unwrapping.running import (
    ONE_OF,
    all_options,
    check_light,
    check_method,
    label_of,
    methods_for,
    noted,
    options_by_id,
    run_method,
    unwrap,
    why_unsuited,
)
from napari_phase4d.unwrapping.shared_steps import FRAMES_LEFT_OUT, PLATEAUS, SharedSteps

__all__ = [
    "BUILT_IN",
    "CAUSAL",
    "FRAMES_LEFT_OUT",
    "METHODS",
    "ONE_OF",
    "ORDERS",
    "PLATEAUS",
    "SCORED_PIXELS",
    "SCORED_TIMES",
    "SCORING_METHOD",
    "STACKS_OF_A_FRAME",
    "Astray",
    "Causal",
    "Given",
    "Judged",
    "Method",
    "Option",
    "Problem",
    "Residues",
    "SharedSteps",
    "Support",
    "ViewsApart",
    "ViewsOf",
    "all_options",
    "all_wavelengths_known",
    "astray",
    "best_frame",
    "border_medians",
    "both_ends",
    "causal_methods",
    "check_light",
    "check_method",
    "checked_boundaries",
    "ends_along",
    "every_plateau",
    "for_what_comes",
    "frame_by_frame",
    "frames_among",
    "graph_bytes",
    "is_known",
    "label_of",
    "left_out_advice",
    "level_residues",
    "loop_sums",
    "median_of",
    "methods_for",
    "noise_of",
    "noted",
    "object_in",
    "odds_by_wavelengths",
    "on_its_field",
    "options_by_id",
    "run_method",
    "score_boundaries",
    "scores_of_some",
    "scores_sentence",
    "settle_plateaus",
    "shown_field",
    "shrunk",
    "supports_by_steps",
    "unwrap",
    "views_apart",
    "views_by_light",
    "why_unsuited",
    "working_blocks",
    "working_frames",
]
