"""What layers say of their stacks, and the regions that are drawn in them; without a window."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from napari.components import ViewerModel

from napari_phase4d._napari.viewing.layers import (
    hologram_layer,
    region_layer,
    stack_layer,
    stack_of_layer,
)
from napari_phase4d._napari.viewing.pointing import newest_region, regions_of_layer
from napari_phase4d.stacks import AXES, UNITS


def stack(**places: list[float]) -> xr.DataArray:
    """Some phase with a pixel of half a micrometre, and other places where they are given."""
    known = {"time": [0.0, 1.0], "angle": [0.0], "y": [0.0, 0.5, 1.0], "x": [0.0, 0.5, 1.0, 1.5]}
    known |= places
    coords = {axis: (axis, known[axis], {"units": UNITS[axis]}) for axis in AXES}
    shape = tuple(len(known[axis]) for axis in AXES)
    values = np.random.default_rng(0).normal(0, 1, shape).astype(np.float32)
    return xr.DataArray(values, dims=AXES, coords=coords, attrs={"units": "rad"})


@pytest.mark.parametrize(
    ("places", "expected"),
    [([8.0, 8.5, 9.0], 0.5), ([9.0, 8.5, 8.0], 0.5), ([1.0, 2.0, 5.0], 2.0), ([3.0] * 3, 1.0)],
    ids=["up", "down", "uneven", "none"],
)
def test_scale_is_the_mean_spacing_in_either_direction(
    places: list[float], expected: float
) -> None:
    _, keywords, _ = stack_layer(stack(y=places), "phase", "wrapped")
    assert keywords["scale"] == [1.0, 1.0, expected, 0.5]
    assert keywords["translate"] == [0.0, 0.0, places[0], 0.0]
    assert region_layer(stack(y=places), "regions")["scale"] == [expected, 0.5]


@pytest.mark.slow
def test_a_layer_gives_its_stack_back(small_video) -> None:
    wanted = stack(time=[0.0, 0.7], angle=[-7.0, 21.0])
    viewer = ViewerModel()
    data, keywords, _ = stack_layer(wanted, "phase", "wrapped")
    found = stack_of_layer(viewer.add_image(data, **keywords))
    xr.testing.assert_identical(found, wanted)
    data, keywords, _ = hologram_layer(small_video)
    found = stack_of_layer(viewer.add_image(data, **keywords))
    np.testing.assert_array_equal(found["time"], small_video.times_s)


def test_the_newest_region_is_the_last_with_an_area() -> None:
    phase = stack(y=[0.5 * n for n in range(20)], x=[0.5 * n for n in range(30)])
    viewer = ViewerModel()
    assert newest_region(viewer, phase) is None
    layer = viewer.add_shapes(**region_layer(phase, "regions"))
    layer.add_lines(np.array([[0, 0], [5, 5]]))
    assert newest_region(viewer, phase) is None
    with pytest.raises(ValueError, match="holds no area"):
        regions_of_layer(layer, phase)
    layer.add_rectangles(np.array([[2, 3], [2, 9], [8, 9], [8, 3]]))
    layer.add_ellipses(np.array([[10, 10], [10, 20], [16, 20], [16, 10]]))
    layer.add_paths(np.array([[0, 0], [5, 5], [9, 1]]))
    regions = regions_of_layer(layer, phase)
    assert list(regions) == ["region 2", "region 3"]
    expected = np.zeros((20, 30), bool)
    expected[2:9, 3:10] = True
    np.testing.assert_array_equal(regions["region 2"], expected)
    np.testing.assert_array_equal(newest_region(viewer, phase), regions["region 3"])
    assert regions["region 3"].sum() == pytest.approx(np.pi * 3 * 5, rel=0.15)
