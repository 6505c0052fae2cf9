"""Reading, writing and filtering of markers, and refusal of invalid files."""

import numpy as np
import opensim
import pytest

from tests.preprocessing.walker import write_trc as write_as_camera_software
from wrapjax.errors import InputError
from wrapjax.preprocessing.files.markers import Markers, match_markers, read_trc, write_trc

TIME = np.arange(120) / 100.0
NAMES = ("HEEL", "TOE", "KNEE")


@pytest.fixture
def places():
    """Slow movements of three markers, m."""
    phase = 2.0 * np.pi * TIME[None, :, None] / 1.1
    start = np.array([[0.0, 0.05, 0.1], [0.2, 0.05, 0.1], [0.0, 1.0, 0.1]])[:, None]
    return start + 0.1 * np.sin(phase + np.arange(3))


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_units_are_converted(tmp_path, places, unit):
    file = tmp_path / "walk.trc"
    write_as_camera_software(file, TIME, [f"Person:{name}" for name in NAMES], places, unit)
    markers = read_trc(file)
    assert markers.names == NAMES
    np.testing.assert_allclose(markers.time, TIME, atol=1e-9)
    np.testing.assert_allclose(markers.positions, places, atol=1e-5)


def test_opensim_reads_written_files(tmp_path, places):
    places[1, 30:40] = np.nan
    file = tmp_path / "walk.trc"
    write_trc(file, Markers(NAMES, TIME, places))
    table = opensim.TimeSeriesTableVec3(str(file)).flatten()
    np.testing.assert_allclose(table.getMatrix().to_numpy(), np.moveaxis(places, 0, 1).reshape(120, 9))
    np.testing.assert_array_equal(read_trc(file).positions, places)


def test_short_gaps_are_filled_and_long_ones_are_kept(places):
    """The filter at 12 Hz hardly changes movements of 0.9 Hz."""
    gaps = places.copy()
    gaps[0, 50:58] = np.nan
    gaps[1, 50:90] = np.nan
    gaps[2, :20] = np.nan
    smooth = Markers(NAMES, TIME, gaps).filtered(12.0).positions
    np.testing.assert_allclose(smooth[0, 10:-10], places[0, 10:-10], atol=4e-3)
    assert np.isnan(smooth[1, 50:90]).all() and np.isfinite(smooth[1, :50]).all()
    assert np.isnan(smooth[2, :20]).all() and np.isfinite(smooth[2, 20:]).all()


BROKEN = {
    "cut off": (lambda text: text[: len(text) // 2].rsplit("\n", 1)[0], "states 120 frames"),
    "no trc": (lambda text: "time,x\n1,2\n", "PathFileType"),
    "another unit": (lambda text: text.replace("\tm\t", "\tfeet\t"), "found 'feet'"),
    "mm in a file that says m": (lambda text: text.replace("\tm\t", "\tmm\t"), "is the unit of length"),
    "label twice": (lambda text: text.replace("TOE", "HEEL"), "'HEEL' twice"),
    "word for a number": (lambda text: text.replace("0.05000", "zero", 1), "could not convert"),
    "frames left out": (lambda text: "\n".join(_without(text.splitlines(), 40, 60)) + "\n", "even frames"),
}


def _without(lines, first, last):
    kept = lines[:first] + lines[last:]
    return [line.replace("\t120\t", f"\t{len(kept) - 6}\t", 1) for line in kept]


@pytest.mark.parametrize("fault", BROKEN)
def test_broken_files_are_refused(tmp_path, places, fault):
    change, words = BROKEN[fault]
    file = tmp_path / "walk.trc"
    write_as_camera_software(file, TIME, NAMES, places, "m")
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=words) as caught:
        read_trc(file)
    assert str(file) in str(caught.value)


def test_markers_of_another_model_are_reported(tmp_path, places):
    with pytest.raises(InputError, match=r"found 1 of 4; did you mean 'toe_l'"):
        match_markers(Markers(("TOE_L", "KNEE"), TIME, places[:2]), ("KNEE", "toe_l", "a", "b"), (), tmp_path)
