"""The quick look: how many views there are, and the picture, for one view and for several."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from typer.testing import CliRunner

import napari_phase4d as p4d
from helpers import measured
from napari_phase4d.cli import app
from napari_phase4d.pipeline import estimated_seconds
from napari_phase4d.simulation import multiplexed_video, swimming_euglena


def run_look(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["look", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


@pytest.fixture
def plain_video(tmp_path: Path) -> Path:
    """A video with one view of a cell, as most microscopes make it."""
    phase = swimming_euglena((128, 128), 5, pixel_um=5.2 / 60 * 4, peak_rad=6)["phase"][:, :1]
    video = multiplexed_video(phase, carriers=[(0.19, 0.21)])
    np.save(tmp_path / "plain.npy", video.holograms.values)
    return tmp_path / "plain.npy"


def rows_of_pictures(path: Path) -> float:
    """Return height over width of a picture."""
    height, width = iio.imread(path).shape[:2]
    return height / width


@pytest.mark.slow
def test_plain_video_has_one_view_and_gets_its_picture(plain_video: Path, tmp_path: Path) -> None:
    out = tmp_path / "one.png"
    code, words = run_look(plain_video, "--out", out)
    assert code == 0
    assert ", 1 view, pixel" in words
    assert "fringe visibility 0.9" in words  # 2 * 1.5 / (1 + 1.5^2) = 0.92
    assert "mrad" in words
    assert "in time" in words
    assert "Safest frame to begin unwrapping from" in words
    picture = iio.imread(out)
    assert picture.std() > 20  # it shows something
    # With two views asked for there is nothing to show; it says what to do.
    with pytest.raises(ValueError, match="ask for 1 view, or place the lobes by hand"):
        run_look(plain_video, "--views", 2, "--out", tmp_path / "two.png")
    assert not (tmp_path / "two.png").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*left out as lost")
def test_no_words_below_the_picture_are_cut_off(plain_video: Path, tmp_path: Path) -> None:
    frames = np.load(plain_video)
    frames[2] = 0
    np.save(plain_video, frames)
    code, words = run_look(plain_video, "--out", tmp_path / "look.png")
    assert code == 0
    assert "Left out as lost" in words  # the end of the longest sentence
    assert (iio.imread(tmp_path / "look.png")[:, -10:, :3] == 255).all()


def test_a_wrong_ending_is_said_before_the_work(plain_video: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["look", str(plain_video), "--out", str(tmp_path / "look")])
    assert "look can't be written as a figure; use one of .png" in str(result.exception)
    assert "Views" not in result.output


@pytest.mark.thorough
def test_multiplexed_video_gets_a_row_for_each_view(plain_video: Path, tmp_path: Path) -> None:
    code, words = run_look(
        "sample:euglena", "--out", tmp_path / "two.png", "--refocus", "auto",
        "--background", "zernike",
    )  # fmt: skip
    assert code == 0
    assert ", 2 views, pixel" in words
    assert "found for a phase object" in words
    assert words.count("? ") >= 2  # angles that nobody knows
    assert "A hologram can't tell the viewing angles" in words
    run_look(plain_video, "--out", tmp_path / "one.png")
    assert rows_of_pictures(tmp_path / "two.png") > 1.2 * rows_of_pictures(tmp_path / "one.png")


@pytest.mark.slow
def test_picture_is_named_after_the_recording_unless_a_name_is_given(
    plain_video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "one.npy", np.load(plain_video)[:1])
    code, words = run_look("one.npy")
    assert code == 0
    assert {path.name for path in tmp_path.glob("*.png")} == {"look_one.png"}
    assert "1 frame looked at, 1 view, pixel" in words
    picture = iio.imread(tmp_path / "look_one.png")
    assert (picture[:, :5] == 255).all()  # no label touches the edge


def test_wrong_inputs_give_one_sentence(plain_video: Path, tmp_path: Path) -> None:
    for arguments, sentence in (
        (("sample:yeast",), "holds wrapped phase, not holograms"),
        ((plain_video, "--refocus", "far"), "--refocus takes micrometres"),
        ((plain_video, "--background", "hills"), "background: background must be one of none"),
    ):
        with pytest.raises(ValueError, match=sentence):
            run_look(*arguments, "--out", tmp_path / "no.png")


@pytest.mark.slow
@pytest.mark.measured
@pytest.mark.parametrize(
    ("name", "array", "views"),
    [
        ("offaxis/hologram_cell.npz", "data", 1),
        ("offaxis/hologram_cell.npz", "bg_data", 1),
        ("offaxis/paramecium_oa_oof.npz", "data", 1),
        ("offaxis/single_holo.tif", "", 1),
        ("offaxis/pydhm_RBC.jpg", "", 1),
        ("offaxis/holobio_20x_SHPC.bmp", "", 1),
        ("offaxis/holobio_40x_Vortex.bmp", "", 1),
        ("offaxis/gasjet_Interferogram_gas.png", "", 1),
        ("multiplexed/mux2_timelapse_t00-29.npz", "chA", 1),
        ("multiplexed/mux2_timelapse_t00-29.npz", "mux", 2),
        ("multiplexed/mux2_cells.npz", "chB", 1),
        ("multiplexed/mux2_cells.npz", "mux", 2),
    ],
)
def test_measured_views_are_counted(name: str, array: str, views: int) -> None:
    path = measured(name)
    if array:
        with np.load(path) as file:
            frames = file[array]
    else:
        frames = iio.imread(path)
        frames = frames[..., 0] if frames.ndim == 3 and frames.shape[-1] == 3 else frames
    assert len(p4d.find_lobes(p4d.open_recording(frames), None)) == views


@pytest.mark.slow
@pytest.mark.measured
def test_measured_multi_carrier_hologram_has_two_views() -> None:
    """Quadri-wave shearing: two carriers, and their sum and difference, which are no views."""
    import h5py

    with h5py.File(measured("multiplexed/qlsi_paa_bead.h5")) as file:
        frame = file["0"][()]
    carriers = [lobe.carrier for lobe in p4d.find_lobes(p4d.open_recording(frame), None)]
    assert len(carriers) == 2


@pytest.mark.slow
@pytest.mark.parametrize("n_views", [1, 2, 3])
def test_simulated_views_are_counted(n_views: int) -> None:
    """Each pair of views leaves a beat as strong as they are, which is no view."""
    carriers = [(0.11, 0.23), (-0.25, 0.12), (0.3, 0.08)][:n_views]
    phase = swimming_euglena((256, 256), 2, pixel_um=0.17, peak_rad=4)["phase"]
    phase = phase.isel(angle=[0] * n_views).assign_coords(angle=np.arange(float(n_views)))
    video = multiplexed_video(phase, carriers=carriers, pupil_radius=0.05)
    assert len(p4d.find_lobes(video, None)) == n_views


def test_one_view_goes_all_the_way(plain_video: Path) -> None:
    """Methods that go along the angle have one angle only, and give what the others give."""
    recipe = p4d.Recipe(recording=str(plain_video), n_views=1, mask=None)
    outcome = p4d.run(recipe)
    results = outcome.comparison.results
    assert results["temporal-angular"].shape[1] == 1
    np.testing.assert_array_equal(
        results["temporal-angular"].values, results["angular-temporal"].values
    )
    np.testing.assert_array_equal(results["temporal-angular"].values, results["temporal"].values)


@pytest.mark.slow
def test_what_a_run_takes_is_told_where_the_first_frames_are_lost(tmp_path: Path) -> None:
    wrapped = swimming_euglena((40, 48), 9, peak_rad=9)["wrapped"].copy()
    wrapped[:6] = np.nan
    file = p4d.write_phase(tmp_path / "lost.ome.tif", wrapped)
    result = CliRunner().invoke(app, ["info", str(file)])
    assert result.exit_code == 0, result.output
    assert "NaN everywhere" not in result.output
    recipe = p4d.Recipe(recording=str(file), content="phase", methods=("temporal",))
    assert estimated_seconds(recipe, p4d.open_phase(file)) > 0
