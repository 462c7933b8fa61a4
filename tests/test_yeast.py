"""The budding yeast of the paper's section 3."""

from __future__ import annotations

import numpy as np

import napari_phase4d as p4d
from napari_phase4d.analysis import itoh_margin
from napari_phase4d.simulation import budding_yeast


def test_axes_are_the_papers() -> None:
    data = budding_yeast()
    assert data["time"][0] == 60  # the paper's t = 1 min
    assert data["phase"].shape == (19, 6, 48, 48)
    np.testing.assert_allclose(data["angle"], [0, 5, 10, 15, 20, 25])
    np.testing.assert_allclose(np.diff(data["time"]), 60)
    assert data.attrs["boundary"] == (0, 0)


def steepest_steps(phase: np.ndarray) -> np.ndarray:
    """Return the largest step between neighbours in each frame, in units of pi."""
    return np.max([np.abs(np.diff(phase, axis=i)).max((2, 3)) for i in (2, 3)], axis=0) / np.pi


def test_thin_at_one_time_from_one_angle_only() -> None:
    data = budding_yeast()
    steep = steepest_steps(data["phase"].values)
    assert steep[0, 0] < 1
    others = np.ones(steep.shape, dtype=bool)
    others[0, 0] = False
    assert steep[others].min() > 1.2


def test_only_the_boundary_frame_can_be_unwrapped_by_itself() -> None:
    data = budding_yeast()
    first = p4d.unwrap(data["wrapped"], "spatial-2d").values
    wrong = (np.abs(first - data["phase"].values) > np.pi).sum((2, 3))
    assert wrong[0, 0] == 0
    right_by_luck = (wrong == 0).sum() - 1
    assert right_by_luck <= 1


def test_same_cell_on_a_finer_grid() -> None:
    coarse = budding_yeast((24, 24), 3)["phase"]
    fine = budding_yeast((48, 48), 3)["phase"]
    np.testing.assert_allclose(fine.values[..., ::2, ::2], coarse.values, atol=1e-5)


def test_steps_are_too_steep_in_every_dimension_somewhere() -> None:
    margin = itoh_margin(budding_yeast()["phase"])
    shares = {name: margin[name].attrs["share_beyond"] for name in margin.data_vars}
    assert all(share > 0 for share in shares.values()), shares
