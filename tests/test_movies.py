"""Movies and figures, decoded again by other programs."""

from __future__ import annotations

import sys
import time
import weakref
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import ListedColormap
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from PIL import Image

import napari_phase4d as p4d
from napari_phase4d.io import write_figure, write_movie
from napari_phase4d.plotting import (
    comparison_figure,
    look_figure,
    movie_frames,
    phase_colours,
    phase_limits,
)

LIMITS = (0.0, 30.0)
#: Video's 8 bits of brightness and colour difference cost up to 2 of 255 in the colours of phase
#: (1.7 measured here, by BT.601 instead of BT.709 it would be 24); the codec may add one.
MP4_TOLERANCE = 3
#: The 256 colours of a frame are chosen among its own; those of large areas are kept (0 measured).
GIF_TOLERANCE = 1


def stack(values: np.ndarray, angles: tuple[float, ...] = (-7.0, 21.0)) -> xr.DataArray:
    """Even frames of the given phase (time, angle)."""
    full = np.broadcast_to(values[..., None, None], (*values.shape, 20, 20)).astype(np.float32)
    coords = {
        "time": 0.5 * np.arange(len(values)),
        "angle": list(angles[: values.shape[1]]),
        "y": 0.2 * np.arange(20),
        "x": 0.2 * np.arange(20),
    }
    return xr.DataArray(full, dims=("time", "angle", "y", "x"), coords=coords)


def phases(column: int, n_times: int = 5) -> np.ndarray:
    """Phase (time, angle) of a column, no two alike."""
    t, a = np.mgrid[:n_times, :2]
    return 1.0 + 10 * column + 4 * a + 0.7 * t


@pytest.fixture(scope="module")
def columns() -> dict[str, xr.DataArray]:
    return {name: stack(phases(i)) for i, name in enumerate(("2-D", "T/A", "WL1"))}


@pytest.fixture(scope="module")
def frames(columns: dict[str, xr.DataArray]) -> list[np.ndarray]:
    return list(movie_frames(columns, LIMITS, title="cell"))


def colour(phase: float, limits: tuple[float, float] = LIMITS) -> np.ndarray:
    low, high = limits
    table = ListedColormap(phase_colours(low, high))
    rgba = table((phase - low) / (high - low), bytes=True)
    return np.asarray(rgba[:3], dtype=int)


def places(frame: np.ndarray, wanted: np.ndarray, tolerance: int = 1) -> np.ndarray:
    """Rows and columns of the pixels of a colour, left of the colour bar."""
    inside = frame[:, : frame.shape[1] - 130].astype(int)
    return np.argwhere((np.abs(inside - wanted) <= tolerance).all(axis=-1))


@pytest.mark.slow
def test_every_phase_is_in_its_place_in_its_colour(frames: list[np.ndarray]) -> None:
    assert len(frames) == 5
    for t, frame in enumerate(frames):
        middles = np.empty((2, 3, 2))
        for column in range(3):
            for row in range(2):
                found = places(frame, colour(phases(column)[t, row]))
                height, width = np.ptp(found, axis=0) + 1
                assert len(found) == height * width > 150**2  # one full rectangle
                middles[row, column] = found.mean(axis=0)
        assert (np.diff(middles[..., 1], axis=1) > 150).all()  # columns from left to right
        assert (np.diff(middles[..., 0], axis=0) > 150).all()  # angles from top to bottom
        assert np.ptp(middles[..., 0], axis=1).max() == 0
        assert np.ptp(middles[..., 1], axis=0).max() == 0


@pytest.mark.slow
def test_only_pictures_and_time_change(frames: list[np.ndarray]) -> None:
    changed = (frames[0] != frames[3]).any(axis=-1)
    assert changed[:30].any()  # the time
    assert not changed[35:60].any()  # the names
    assert not changed[:, -125:].any()  # the colour bar
    names = frames[0][35:60, :-130].min(axis=-1) < 128
    assert names.sum() > 100


@pytest.mark.thorough
@pytest.mark.parametrize("n_rows", [1, 2, 6])
@pytest.mark.parametrize("n_columns", [1, 2, 9])
@pytest.mark.parametrize("aspect", [1, 2.7])
def test_sizes_are_even_and_no_picture_is_small(
    n_columns: int, n_rows: int, aspect: float
) -> None:
    values = np.full((1, n_rows), 3.0)
    one = stack(values, tuple(range(n_rows)))
    one = one.assign_coords(y=one["y"] * aspect)
    names = [f"a rather long name of method {i}" for i in range(n_columns)]
    frame = next(movie_frames(dict.fromkeys(names, one), (0.0, 10.0)))
    assert frame.shape[0] % 2 == frame.shape[1] % 2 == 0
    assert max(frame.shape) <= 4096  # the largest picture that every player of H.264 shows
    found = places(frame, colour(3.0, (0.0, 10.0)))
    assert len(found) >= n_columns * n_rows * 175**2 * min(aspect, 2)
    # Letters that were cut off would leave ink at the border.
    border = np.concatenate([frame[0], frame[-1], frame[:, 0], frame[:, -1]])
    assert (border == 255).all()


def test_pixels_that_are_nan_stay_white_when_the_next_frame_has_them(columns) -> None:
    moving = columns["T/A"].copy(deep=True)
    moving[1, 0, :10] = np.nan
    first, second, *_ = movie_frames({"T/A": moving}, LIMITS)
    where = places(first, colour(float(moving[0, 0, 0, 0])))
    top = where[: len(where) // 2 - 1000]
    assert (second[top[:, 0], top[:, 1]] == 255).all()
    assert np.isfinite(phase_limits([moving.values])).all()


def test_stacks_that_do_not_fit_are_refused(columns) -> None:
    short = columns["2-D"].isel(time=slice(3))
    with pytest.raises(ValueError, match="WL1 has 3 times and 2 angles, but 2-D has 5 and 2"):
        next(movie_frames({"2-D": columns["2-D"], "WL1": short}, LIMITS))
    with pytest.raises(ValueError, match="no stacks"):
        next(movie_frames({}, LIMITS))


@pytest.mark.slow
def test_mp4_as_other_programs_see_it(frames: list[np.ndarray], tmp_path: Path) -> None:
    path = write_movie(tmp_path / "movie.mp4", iter(frames), 6.0)
    with av.open(str(path)) as container:
        video = container.streams.video[0]
        assert video.codec_context.name == "h264"
        assert video.pix_fmt == "yuv420p"
        assert video.average_rate == 6
        decoded = list(container.decode(video))
    assert len(decoded) == 5
    np.testing.assert_allclose([f.time for f in decoded], np.arange(5) / 6, atol=1e-3)
    for t, (frame, found) in enumerate(zip(frames, decoded, strict=True)):
        picture = from_bt709(found)
        assert picture.shape == frame.shape
        for column in range(3):
            for row in range(2):
                assert flat_error(frame, picture, colour(phases(column)[t, row])) <= MP4_TOLERANCE


def from_bt709(frame: av.VideoFrame) -> np.ndarray:
    """RGB by the formulas of ITU-R BT.709 and BT.1361, from brightness and differences."""
    planes = []
    for plane in frame.planes:
        rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
        planes.append(rows[:, : plane.width].astype(float))
    y = (planes[0] - 16) / 219
    blue, red = (np.kron(p - 128, np.ones((2, 2))) / 224 for p in planes[1:])
    r, b = y + 1.5748 * red, y + 1.8556 * blue
    g = (y - 0.2126 * r - 0.0722 * b) / 0.7152
    return np.clip(255 * np.stack([r, g, b], axis=-1), 0, 255)


def flat_error(frame: np.ndarray, picture: np.ndarray, wanted: np.ndarray) -> float:
    """Largest error of a colour, 10 pixels and more from the edge of where it was drawn."""
    found = places(frame, wanted)
    (top, left), (bottom, right) = found.min(axis=0) + 10, found.max(axis=0) - 10
    return float(np.abs(picture[top:bottom, left:right].astype(float) - wanted).max())


@pytest.mark.slow
def test_gif_as_other_programs_see_it(frames: list[np.ndarray], tmp_path: Path) -> None:
    path = write_movie(tmp_path / "movie.gif", iter(frames), 4.0)
    with Image.open(path) as image:
        assert image.n_frames == 5
        assert image.info["loop"] == 0
        for t, frame in enumerate(frames):
            image.seek(t)
            assert image.info["duration"] == 250
            picture = np.asarray(image.convert("RGB"))
            assert picture.shape == frame.shape
            for column in range(3):
                for row in range(2):
                    wanted = colour(phases(column)[t, row])
                    assert flat_error(frame, picture, wanted) <= GIF_TOLERANCE


def test_odd_sizes_are_made_even(tmp_path: Path) -> None:
    frame = np.full((33, 47, 3), 200, np.uint8)
    path = write_movie(tmp_path / "odd.mp4", [frame, frame])
    with av.open(str(path)) as container:
        decoded = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert [f.shape for f in decoded] == [(34, 48, 3)] * 2
    assert np.abs(decoded[1].astype(int) - 200).max() <= MP4_TOLERANCE


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_frames_are_let_go_one_by_one(tmp_path: Path, ending: str) -> None:
    alive: list[weakref.ref[np.ndarray]] = []

    def drawn() -> Iterator[np.ndarray]:
        for i in range(20):
            frame = np.full((64, 64, 3), 10 * i, np.uint8)
            alive.append(weakref.ref(frame))
            assert sum(ref() is not None for ref in alive) <= 4
            yield frame

    write_movie(tmp_path / f"movie{ending}", drawn())
    assert len(alive) == 20


@pytest.mark.thorough
@pytest.mark.parametrize("ending", [".gif", ".mp4"])
@pytest.mark.parametrize("after", [0, 1, 6])
def test_cancelled_movie_leaves_nothing(tmp_path: Path, ending: str, after: int) -> None:
    reports: list[tuple[int, int, str]] = []
    path = tmp_path / f"movie{ending}"
    path.write_text("an older movie")
    noise = np.random.default_rng(0).integers(0, 255, (600, 800, 3), dtype=np.uint8)
    asked: list[float] = []

    def cancelled() -> bool:
        if len(reports) >= after:
            asked.append(time.perf_counter())
        return bool(asked)

    with pytest.raises(p4d.Cancelled):
        write_movie(
            path, (np.roll(noise, i, axis=1) for i in range(30)), n_frames=30,
            progress=lambda *report: reports.append(report), cancelled=cancelled,
        )  # fmt: skip
    assert time.perf_counter() - asked[0] < 1
    assert reports == [(i + 1, 30, "writing the movie") for i in range(after)]
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "an older movie"


@pytest.mark.slow
def test_gif_is_cancelled_while_it_is_compressed_at_the_end(tmp_path: Path) -> None:
    reports: list[object] = []

    def cancelled() -> bool:
        return any(p.stat().st_size > 100_000 for p in tmp_path.iterdir())

    noise = np.random.default_rng(0).integers(0, 255, (300, 400, 3), dtype=np.uint8)
    with pytest.raises(p4d.Cancelled):
        write_movie(
            tmp_path / "movie.gif", (np.roll(noise, i, axis=1) for i in range(10)),
            progress=lambda *report: reports.append(report), cancelled=cancelled,
        )  # fmt: skip
    assert len(reports) == 10
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_frame_that_fails_leaves_nothing(tmp_path: Path, ending: str) -> None:
    def drawn() -> Iterator[np.ndarray]:
        yield np.zeros((32, 32, 3), np.uint8)
        msg = "no more"
        raise ZeroDivisionError(msg)

    with pytest.raises(ZeroDivisionError):
        write_movie(tmp_path / f"movie{ending}", drawn())
    assert not list(tmp_path.iterdir())


def test_wrong_wishes_give_one_sentence(tmp_path: Path, monkeypatch) -> None:
    frame = np.zeros((32, 32, 3), np.uint8)
    with pytest.raises(ValueError, match=r"\.gif or \.mp4, but the name is a\.avi"):
        write_movie(tmp_path / "a.avi", [frame])
    with pytest.raises(ValueError, match=r"no frames to write to a\.gif"):
        write_movie(tmp_path / "a.gif", [])
    for rate in (0, -1, float("nan"), float("inf"), 51):
        with pytest.raises(ValueError, match="at most 50 frames per second"):
            write_movie(tmp_path / "a.gif", [frame], rate)
    monkeypatch.setitem(sys.modules, "av", None)  # as if it were not installed
    with pytest.raises(ValueError, match=r'pip install "napari-phase4d\[video\]"'):
        write_movie(tmp_path / "a.mp4", [frame])
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_figure_in_svg_keeps_the_names_as_words(columns, tmp_path: Path) -> None:
    path = tmp_path / "figure.svg"
    write_figure(path, comparison_figure(columns, [(0, 0), (4, 1)]))
    root = ET.fromstring(path.read_text(encoding="utf-8"))
    words = {"".join(e.itertext()).strip() for e in root.iter() if e.tag.endswith("}text")}
    assert {"2-D", "T/A", "WL1", "phase (rad)", "-7°", "21°"} <= words
    assert sum(1 for e in root.iter() if e.tag.endswith("}image")) >= 6


@pytest.mark.parametrize(("first", "step"), [(33.0, 0.5), (-100.0, 0.5), (16.0, -0.5), (0.0, 2.0)])
def test_a_scale_bar_is_as_long_as_it_says(columns, first: float, step: float) -> None:
    """Also of a part of a field, left of the origin, and from right to left."""
    stack = next(iter(columns.values()))
    n = stack.sizes["x"]
    stack = stack.assign_coords(x=("x", first + step * np.arange(n), {"units": "um"}))
    axis = comparison_figure({"2-D": stack}, [(0, 0)]).axes[0]
    # The picture is as wide as its pixels are together, and the bar a part of that.
    width = abs(axis.get_xlim()[1] - axis.get_xlim()[0])
    assert width == pytest.approx(n * abs(step))
    (bar,) = (a for a in axis.artists if isinstance(a, AnchoredSizeBar))
    (drawn,) = bar.size_bar.get_children()
    assert bar.txt_label.get_text() == f"{drawn.get_width():g} µm"
    assert 0.12 * width < drawn.get_width() <= 0.3 * width


@pytest.mark.slow
def test_figure_in_png_has_the_colours_of_the_phase(columns, tmp_path: Path) -> None:
    path = tmp_path / "figure.png"
    write_figure(path, comparison_figure(columns, [(0, 0), (4, 1)], limits=LIMITS))
    with Image.open(path) as image:
        picture = np.asarray(image.convert("RGB"))
    for column in range(3):
        for t, row in ((0, 0), (4, 1)):
            assert len(places(picture, colour(phases(column)[t, row]))) > 100**2


@pytest.mark.parametrize(
    ("times", "labels"),
    [
        (100_000 + 60.0 * np.arange(4), ["1666.7 min", "1667.7 min", "1668.7 min", "1669.7 min"]),
        (np.array([-900.0, -600.0, -300.0, 0.0]), ["-15 min", "-10 min", "-5 min", "0 min"]),
        (30 + 0.04 * np.arange(3), ["30 s", "30.04 s", "30.08 s"]),
        (np.array([0.0, 0.5]), ["0 s", "0.5 s"]),
        (np.array([1234.0]), ["20.6 min"]),
    ],
)
def test_labels_tell_following_times_apart(times: np.ndarray, labels: list[str]) -> None:
    frames = stack(np.zeros((len(times), 1))).assign_coords(time=times)
    figure = comparison_figure({"2-D": frames}, [(t, 0) for t in range(len(times))])
    found = [axis.get_ylabel().split("t = ")[-1] for axis in figure.axes[: len(times)]]
    assert found == labels


@pytest.mark.slow
def test_a_view_of_which_nothing_is_known_is_drawn_empty(tmp_path: Path) -> None:
    phase = stack(np.zeros((1, 2))).copy(deep=True)
    phase[0, 1] = np.nan
    data = xr.Dataset({"phase": phase, "amplitude": phase + 1})
    k = np.linspace(-0.5, 0.5, 16)
    spectrum = xr.DataArray(np.ones((16, 16)), dims=("ky", "kx"), coords={"ky": k, "kx": k})
    figure = look_figure(np.eye(20, dtype=np.float32), spectrum, [], data, phase)
    assert write_figure(tmp_path / "look.png", figure).stat().st_size > 1000


@pytest.mark.parametrize("rate", [1.0, 7.0, 15.0, 30.0, 40.0, 50.0])
def test_a_gif_takes_as_long_as_asked_for(tmp_path: Path, rate: float) -> None:
    """Each frame alone takes whole hundredths of a second: at 40 a second it played 50."""
    pictures = [np.full((8, 8, 3), 10 * n, np.uint8) for n in range(24)]
    path = write_movie(tmp_path / "movie.gif", pictures, rate)
    with Image.open(path) as movie:
        assert movie.n_frames == 24
        lasts = 0
        for n in range(24):
            movie.seek(n)
            assert abs(movie.info["duration"] - 1000 / rate) < 10
            lasts += movie.info["duration"]
    assert lasts == pytest.approx(1000 * 24 / rate, abs=5)
    with Image.open(write_movie(tmp_path / "one.gif", pictures[:1], rate)) as single:
        assert single.n_frames == 1


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_frames_that_are_no_pictures_of_one_size_are_refused(tmp_path: Path, ending: str) -> None:
    small, large = (np.zeros((n, n, 3), np.uint8) for n in (8, 16))
    for frames, words in (
        ([small, large], "frame 1 has 16 x 16 pixels, and the first 8 x 8"),
        ([small[..., 0]], "but frame 0 is uint8 of shape"),
        ([small, small / 2.0], "but frame 1 is float64 of shape"),
    ):
        with pytest.raises(ValueError, match=words):
            write_movie(tmp_path / f"movie{ending}", frames)
    assert not list(tmp_path.iterdir())


def test_pictures_take_stacks_in_other_units_and_orders(columns) -> None:
    """Milliseconds stood there as seconds, radians as degrees, and the picture was another one."""
    plain = next(iter(columns.values()))
    factors = {"time": (1e3, "ms"), "angle": (np.pi / 180, "rad")}
    factors |= {"y": (1e3, "nm"), "x": (1e-3, "mm")}
    units = {"time": "s", "angle": "deg", "y": "um", "x": "um"}
    noted = plain.assign_coords({d: (d, plain[d].values, {"units": u}) for d, u in units.items()})
    other = plain.assign_coords(
        {d: (d, plain[d].values * f, {"units": u}) for d, (f, u) in factors.items()}
    ).transpose("x", "angle", "time", "y")
    turned = np.rad2deg(other).assign_attrs(units="deg")
    frames = [(3, 1), (1, 0)]
    wanted, *found = (comparison_figure({"it": s}, frames) for s in (noted, other, turned))
    for figure in found:
        for axis, right in zip(figure.axes, wanted.axes, strict=True):
            assert axis.get_ylabel() == right.get_ylabel()
            for image, exact in zip(axis.images, right.images, strict=True):
                np.testing.assert_allclose(image.get_array(), exact.get_array(), rtol=1e-5)
                np.testing.assert_allclose(image.get_extent(), exact.get_extent())
    assert "21°" in wanted.axes[0].get_ylabel()
    movies = [list(movie_frames({"it": s}, LIMITS)) for s in (noted, other)]
    # 40.000000001 micrometres instead of 40 shift letters by a rounding.
    np.testing.assert_allclose(*np.array(movies, dtype=np.int16), atol=3)


def test_frames_and_limits_that_are_not_there_are_refused(columns) -> None:
    with pytest.raises(ValueError, match=r"frames must be \(time, angle\) below \(5, 2\)"):
        comparison_figure(columns, [(5, 0)])
    for limits in ((1.0, 1.0), (2.0, 1.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(ValueError, match="limits must be two finite numbers that rise"):
            comparison_figure(columns, [(0, 0)], limits=limits)
        with pytest.raises(ValueError, match="limits must be two finite numbers that rise"):
            next(movie_frames(columns, limits))


def test_what_is_no_phase_is_drawn_as_it_is(columns) -> None:
    plain = next(iter(columns.values()))
    for units in ("nm", "pg/um^2", "1", "a.u.", "whatever", None):
        drawn = comparison_figure({"it": plain.assign_attrs(units=units)}, [(2, 1)])
        np.testing.assert_array_equal(
            drawn.axes[0].images[0].get_array(), plain.values[2, 1].astype(np.float64)
        )


def test_opacity_is_left_out_of_movies(tmp_path: Path) -> None:
    frames = [np.full((8, 8, 4), value, np.uint8) for value in (10, 200)]
    with Image.open(write_movie(tmp_path / "movie.gif", frames)) as movie:
        assert movie.n_frames == 2
