"""All unwrapping methods, in the order in which they are shown."""

from __future__ import annotations

from collections.abc import Mapping

from napari_phase4d.unwrapping import chain, volumes
from napari_phase4d.unwrapping.dilate_erode import dilate_erode
from napari_phase4d.unwrapping.directional import directional_growing, directional_l1
from napari_phase4d.unwrapping.installed import WithInstalled
from napari_phase4d.unwrapping.laplacian import laplacian
from napari_phase4d.unwrapping.light.synthetic import BEATS, synthetic_wavelength
from napari_phase4d.unwrapping.method import Method, Option
from napari_phase4d.unwrapping.network_flow import network_flow

__all__ = ["BUILT_IN", "METHODS"]

OWN = "This project"
#: Memory of the directional methods for each pixel of a block (all that steps are weighed by), and
#: of the recording (regions, and the edges between them), in bytes; on disk the phase without
#: noise, the noise that is left, groups and turns.
OF_A_BLOCK, OF_REGIONS, OF_SCRATCH = 300, 2.0, 16
#: Memory of DE for each pixel of a block: what is carried is in double precision.
OF_DILATING = 80
#: Memory of Flow for each pixel of a block, in bytes; on disk the phase again, the turns and costs
#: of steps, and the turns of pixels.
OF_FLOWS, OF_STEPS = 160, 30
#: Memory of LBE for each pixel of a block, in bytes; on disk what is transformed.
OF_TRANSFORMS, OF_SPECTRA = 60, 26
#: Memory of RG and 3-D for each pixel of a block, in bytes; on disk group and turns of every
#: pixel, and lists of groups.
OF_GROWING, OF_GROUPS = 200, 20
PAPER = "Dardikman, Singh & Shaked 2018, section 2"
CHAIN_OPTIONS = (
    Option(
        "registration",
        True,
        "Move frames by whole pixels so that the object's centre of mass stays in place.",
    ),
    Option(
        "split",
        True,
        "Start anew where the object has become as thin again as in the boundary frame.",
    ),
)

VARIANT = Option(
    "variant",
    "textbook",
    '"textbook", as the method is described, or "phasetools", as PhaseTools computes it.',
    ("textbook", "phasetools"),
)

#: The methods of this program.
BUILT_IN: dict[str, Method] = {
    "spatial-2d": Method(
        "2-D",
        "Herraez et al. 2002, Appl. Opt. 41, 7437",
        "Each frame by itself, most reliable pixels first.",
        chain.spatial_2d,
        (
            Option(
                "reliability",
                "herraez",
                '"herraez", as published: pixels whose phase bends least first; "coherence": '
                "steps first that are like those round them, better on steep or noisy phase.",
                ("herraez", "coherence"),
            ),
        ),
        streams=True,
        name="frame by frame, by reliability",
    ),
    "angular": Method(
        "Angular",
        "Dardikman et al. 2017, Opt. Express 25, 3347",
        "From the thin angle to the others, at each time.",
        chain.angular,
        CHAIN_OPTIONS,
        streams=True,
        name="along the angle only",
    ),
    "temporal": Method(
        "Temporal",
        PAPER,
        "From the thin time to the others, for each angle.",
        chain.temporal,
        CHAIN_OPTIONS,
        streams=True,
        name="along time only",
    ),
    "temporal-angular": Method(
        "T/A",
        PAPER + ", Fig. 1(a)",
        "Along time first, then along the angle.",
        chain.temporal_angular,
        CHAIN_OPTIONS,
        streams=True,
        name="along time, then angle",
    ),
    "angular-temporal": Method(
        "A/T",
        PAPER + ", Fig. 1(b)",
        "Along the angle first, then along time.",
        chain.angular_temporal,
        CHAIN_OPTIONS,
        streams=True,
        name="along angle, then time",
    ),
    "laplacian": Method(
        "LBE",
        "Schofield & Zhu 2003, Opt. Lett. 28, 1194; in 4-D: Barnhill et al. 2015",
        "Solves for the phase whose Laplacian is that of the wrapped phase; an estimate.",
        laplacian,
        (
            VARIANT,
            Option("rounded", False, "Add whole turns to the wrapped phase, the nearest to it."),
        ),
        working_stacks=8.0,
        streams=True,
        block_bytes=OF_TRANSFORMS,
        scratch_bytes=OF_SPECTRA,
        name="Laplacian-based estimate",
    ),
    "region-growing": Method(
        "RG",
        "Abdul-Rahman et al. 2007, Appl. Opt. 46, 6623; in 4-D: Barnhill et al. 2015",
        "Joins pixels over time, angle, y and x, most reliable edges first.",
        volumes.region_growing,
        (
            VARIANT,
            Option(
                "rga_threshold",
                3.14,
                'Only with "phasetools": step in radians beyond which a turn is added.',
            ),
        ),
        working_stacks=50.0,  # of "phasetools"; "textbook" takes 15,
        streams=True,
        block_bytes=OF_GROWING,
        scratch_bytes=OF_GROUPS,
        name="region growing in 4-D",
    ),
    "dilate-erode": Method(
        "DE",
        "Dilate-erode-propagate: Barnhill et al. 2015, Magn. Reson. Med. 73, 2321",
        "Mends the boundary frame with windows, then carries its phase from frame to frame.",
        dilate_erode,
        (
            VARIANT,
            Option(
                "max_window",
                0,
                "Half the width of the largest window in pixels; 0, as published: no windows.",
            ),
            Option(
                "erode_threshold",
                6.0,
                "Largest second difference over three frames, in radians, of a valid pixel.",
            ),
        ),
        working_stacks=6.0,
        streams=True,
        block_bytes=OF_DILATING,
        name="dilate, erode, propagate",
    ),
    "spatial-3d": Method(
        "3-D",
        "Abdul-Rahman et al. 2007, Appl. Opt. 46, 6623",
        "Joins pixels over time, y and x for each angle, most reliable edges first.",
        volumes.spatial_3d,
        working_stacks=10.0,
        streams=True,
        block_bytes=OF_GROWING,
        scratch_bytes=OF_GROUPS,
        name="reliability in time, y and x",
    ),
    "network-flow": Method(
        "Flow",
        "Pepe & Lanari 2006, IEEE Trans. Geosci. Remote Sens. 44, 2374; after Costantini",
        "Fewest whole turns that close all loops: over time and angle, then in each frame.",
        network_flow,
        working_stacks=36.0,
        streams=True,
        block_bytes=OF_FLOWS,
        scratch_bytes=OF_STEPS,
        name="network flow, time and angle first",
    ),
    "directional-growing": Method(
        "RGd",
        OWN,
        "Joins pixels over time, angle, y and x, first where steps change least along themselves.",
        directional_growing,
        working_stacks=26.0,
        finds_object=True,
        leaves_out=True,
        streams=True,
        block_bytes=OF_A_BLOCK,
        kept_bytes=OF_REGIONS,
        scratch_bytes=OF_SCRATCH,
        name="directional region growing",
    ),
    "directional-l1": Method(
        "WL1",
        OWN,
        "Whole turns that disagree least with all steps, each weighted by how smooth it is.",
        directional_l1,
        (
            Option(
                "one_sided",
                True,
                "The object is nowhere optically thinner than the empty field round it (or "
                "nowhere denser): where the steps can't tell, prefer that.",
            ),
        ),
        working_stacks=26.0,
        finds_object=True,
        leaves_out=True,
        streams=True,
        block_bytes=OF_A_BLOCK,
        kept_bytes=OF_REGIONS,
        scratch_bytes=OF_SCRATCH,
        name="directional L1",
    ),
    "synthetic-wavelength": Method(
        "Synthetic",
        "Gass, Dakoff & Kim 2003, Opt. Lett. 28, 1141; of multiplexed holograms: Mirsky & Shaked "
        "2023, Sci. Rep. 13, 19293",
        "From the beat of two or three wavelengths down to the shortest; tells sheer steps too.",
        synthetic_wavelength,
        (
            Option(
                "beat",
                "spatial",
                'How the phase of the longest synthetic wavelength is unwrapped; "wrapped" where '
                "the object is thinner than half of it everywhere.",
                tuple(BEATS),
            ),
            Option(
                "settle",
                True,
                "Settle turns that noise leaves in doubt together with their neighbours'.",
            ),
            Option(
                "cauchy_um2",
                0.0,
                "Dispersion of the object: C in 1 + C / wavelength^2, in square micrometres.",
            ),
        ),
        working_stacks=20.0,  # with the beat by WL1; else 8
        finds_object=True,
        streams=True,
        block_bytes=OF_A_BLOCK // 2,  # there are half as many beats as views at most
        kept_bytes=OF_REGIONS / 2,
        scratch_bytes=OF_SCRATCH,
        wavelengths=2,
        name="synthetic wavelength, hierarchical",
    ),
}

#: Method id -> Method: those of this program, then those of installed packages by their ids.
METHODS: Mapping[str, Method] = WithInstalled(BUILT_IN)
