"""Known errors added to recordings, and the summary of their diagnoses."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from validation.recorded import __main__ as recorded
from validation.recorded.injected_errors import (
    Cycle,
    Variant,
    injections,
    knock_outs,
    with_crosstalk,
    with_delay,
    with_drift,
    with_filter,
    with_spring,
    with_wrong_mass,
    write_variant,
)
from wrapjax.errors import InputError
from wrapjax.io.storage import Storage, read_storage

TIME = np.linspace(1.0, 2.0, 201)
EMG = ("Sol", "TibAnt")


def table(columns, values, in_degrees=False):
    return Storage("table", tuple(columns), TIME, np.stack(values, axis=1), in_degrees)


@pytest.fixture
def cycles():
    """Build two cycles for each of two speeds, with a rising channel and a constant one."""
    emg = table(EMG, [TIME, np.ones_like(TIME)])
    moments = table(["ankle_angle_l_moment"], [np.sin(40.0 * TIME)])
    angles = table(["ankle_angle_l"], [np.full_like(TIME, 10.0)], in_degrees=True)
    return [
        Cycle(order, speed, emg, moments, angles)
        for order, speed in ((0, 0.5), (1 / 3, 0.5), (2 / 3, 0.8), (1, 0.8))
    ]


def inner(cycle, channel="Sol"):
    """Return a channel without the ends, where shifted values are extrapolated."""
    return cycle.emg.values[20:-20, EMG.index(channel)]


def test_delays_differ_by_speed_with_zero_mean(cycles):
    slow, _, _, fast = with_delay(cycles, 0.040)
    assert inner(slow) == pytest.approx(TIME[20:-20] - 0.020)
    assert inner(fast) == pytest.approx(TIME[20:-20] + 0.020)


def test_drift_is_a_ramp_over_cycles_in_one_channel(cycles):
    found = with_drift(cycles, "Sol", 0.6)
    assert [c.emg.values[0, 0] / TIME[0] for c in found] == pytest.approx([0.7, 0.9, 1.1, 1.3])
    assert all((inner(c, "TibAnt") == 1.0).all() for c in found)


def test_crosstalk_adds_the_recorded_signal(cycles):
    first = with_crosstalk(cycles, "Sol", "TibAnt", 0.3)[0]
    assert inner(first, "TibAnt") == pytest.approx(1.0 + 0.3 * TIME[20:-20])
    assert (inner(first) == TIME[20:-20]).all()


def test_spring_changes_measured_moments(cycles):
    first = with_spring(cycles, "ankle_angle_l", 1.5)[0]
    assert first.moments.values - cycles[0].moments.values == pytest.approx(-15.0)
    radians = replace(cycles[0], angles=replace(cycles[0].angles, in_degrees=False))
    with pytest.raises(InputError, match="radians"):
        with_spring([radians], "ankle_angle_l", 1.5)


def test_filter_smooths_one_signal_and_mass_scales_moments(cycles):
    first = with_filter(cycles, "moments", 3.0)[0]
    assert np.ptp(first.moments.values[50:-50]) < 0.5 * np.ptp(cycles[0].moments.values)
    assert first.emg is cycles[0].emg
    assert with_wrong_mass(cycles, 1.15)[0].moments.values == pytest.approx(1.15 * cycles[0].moments.values)


def test_variants_have_unique_names_and_effects_of_the_catalogue():
    from wrapjax.diagnosis.effects.catalogue import CATALOGUE

    every = [*injections("l"), *knock_outs()]
    assert len({one.name for one in every}) == len(every) == 17
    assert {one.effect for one in every} - {None} <= set(CATALOGUE)


def test_source_files_are_unchanged_and_hidden_channel_is_removed(s1_left, tmp_path):
    source, folder = tmp_path / "source", tmp_path / "made"
    shutil.copytree(s1_left, source, ignore=shutil.ignore_patterns("reference_geometry"))
    before = {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}
    (hidden,) = (one for one in knock_outs() if one.hidden == "TibPost")
    write_variant(source, folder, hidden)
    assert "TibPost =" not in (folder / "subject.toml").read_text()
    assert "TibAnt =" in (folder / "subject.toml").read_text()
    drifted = next(one for one in injections("l") if one.name == "drift_2")
    write_variant(source, folder, drifted)
    ratio = [
        read_storage(folder / own).values[:, 11].max() / read_storage(source / own).values[:, 11].max()
        for own in ("trials/walk_0p5_1/emg.sto", "trials/walk_0p8_4/emg.sto")
    ]
    assert ratio == pytest.approx([0.7, 1.3])
    assert {path: path.read_bytes() for path in source.rglob("*") if path.is_file()} == before
    with pytest.raises(InputError, match="no channel 'Nobody'"):
        write_variant(source, folder, Variant("x", "", list, None, hidden="Nobody"))


def test_increases_are_relative_to_the_original_recording():
    before = {"evidence": {"emg_drift": 5.0, "emg_crosstalk": 1.0, "cop_offset": 9.0}}
    variants = [
        Variant(name, f"{name}!", list, "emg_drift") for name in ("drift_1", "drift_2", "other_2", "more_2")
    ]
    variants.append(Variant("without_TibPost", "no electrode", list, "missing_drive", "TibPost"))
    kept = {
        "drift_1": {"evidence": {"emg_drift": 6.0, "emg_crosstalk": 4.0, "cop_offset": 9.0}},
        "drift_2": {"evidence": {"emg_drift": 25.0, "emg_crosstalk": 4.0, "cop_offset": 9.0}},
        "other_2": {"evidence": {"emg_drift": 5.0, "emg_crosstalk": 1.5, "cop_offset": 9.0}},
        "more_2": {"evidence": {"emg_drift": 6.0, "emg_crosstalk": 1.5, "cop_offset": 9.0}},
        "without_TibPost": {
            "outcome": "tie",
            "named": [],
            "ties": [["missing_drive", "cop_offset"]],
            "drive": {
                "groups": [
                    {"group": "sart", "own": False, "correlation": 0.1, "correlation_delayed": 0.2},
                    {"group": "tibpost", "own": True, "correlation": 0.7, "correlation_delayed": 0.85},
                ]
            },
        },
    }
    summary = recorded.summarize(before, variants, kept)
    assert [row["place"] for row in summary["rows"][:4]] == [2, 1, 2, 1]
    assert summary["rows"][0]["first"] == "emg_crosstalk" and summary["rows"][4]["found"] is True
    assert summary["rose_most_at_twice"] == pytest.approx(2 / 3)
    text = recorded.as_text(summary)
    assert "| drift_2! | +20.0 | 1 | `emg_drift` +20.0 |" in text and "in 67 % of 3 (target: 80 %)" in text
    assert "| tie missing_drive, cop_offset | 0.70, 0.85 (tibpost, rank 2 of 2 groups) |" in text


def test_unknown_variant_is_an_input_error(s1_left, monkeypatch, tmp_path, capsys):
    arguments = ["recorded", "--subject", str(s1_left), "--out", str(tmp_path), "--only", "nobody"]
    monkeypatch.setattr("sys.argv", arguments)
    assert recorded.main() == 2
    assert "there is no variant 'nobody'" in capsys.readouterr().err


def test_excitation_is_compared_with_earlier_emg():
    """Check that excitation may lag behind EMG but not lead it; zero excitation has no correlation."""
    from validation.recorded.variant_results import PHASES, correlations

    emg = np.exp(-(((np.linspace(0.0, 1.0, PHASES) - 0.4) / 0.05) ** 2))
    later, earlier = (np.append(np.roll(emg[:-1], shift), emg[0]) for shift in (5, -5))
    assert correlations(emg, emg)["correlation"] == pytest.approx(1.0)
    assert correlations(later, emg)["correlation"] < 0.7
    assert correlations(later, emg)["correlation_delayed"] == pytest.approx(1.0)
    assert correlations(earlier, emg)["correlation_delayed"] < 0.7
    assert correlations(0.0 * emg, emg) == {"correlation": None, "correlation_delayed": None}
