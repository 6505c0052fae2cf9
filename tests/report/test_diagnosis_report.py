"""The folder of a diagnosis keeps its contract, opens anywhere, and says no more than was found."""

import base64
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from tests.report.made_up_gap import CENTER, COORDINATES, ENDINGS, ORTHOSIS, SPEEDS, finding, named
from tests.report.test_html import Page
from wrapjax import InputError
from wrapjax.cli.diagnose import diagnosis_table
from wrapjax.diagnosis.effects.effect import NotTestable
from wrapjax.diagnosis.error_budget import BINS, Budget
from wrapjax.diagnosis.result import OUTCOMES, EffectSize, Estimate, Released
from wrapjax.io.storage import read_storage
from wrapjax.report import diagnosis_page as gap_folder
from wrapjax.report.diagnosis_effects import alike_pairs, half_interval
from wrapjax.report.diagnosis_location import resolved
from wrapjax.report.diagnosis_numbers import describe_diagnosis, mean_absolute_errors, moment_table, where
from wrapjax.report.diagnosis_page import render_diagnosis, write_diagnosis
from wrapjax.report.diagnosis_shrinkage import MOST_RELEASED, accepted_shares, most_released
from wrapjax.report.diagnosis_words import findings, untested

#: The contract's keys.
KEYS = {
    *("schema", "outcome", "named", "ties", "credible_set", "effects", "where", "explainable_share"),
    *("shrinkage", "mae_Nm", "not_testable", "advice"),
}
SILENT = ("insufficient_data", "not_converged")


def _refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write each ending once; drawing takes a while."""
    folders = {}

    def write(ending, subject):
        if ending not in folders:
            folders[ending] = tmp_path_factory.mktemp("gaps") / ending
            write_diagnosis(subject, ENDINGS[ending](), folders[ending])
        return folders[ending]

    return write


def _content(folder):
    return json.loads((folder / "gap.json").read_text(), parse_constant=_refuse)


def _files(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_there_is_a_made_up_diagnosis_for_each_way_to_end():
    assert set(ENDINGS) == set(OUTCOMES)


@pytest.mark.parametrize("ending", OUTCOMES)
def test_the_folder_holds_what_was_promised_and_nothing_else(ending, written, subject):
    folder = written(ending, subject)
    assert _files(folder) == ["gap.json", "moments/walk.sto", "report.html"]


@pytest.mark.parametrize("ending", OUTCOMES)
def test_the_contract_is_kept_however_it_ends(ending, written, subject):
    content = _content(written(ending, subject))
    assert content.keys() >= KEYS
    assert content["schema"] == 1 and content["outcome"] == ending
    probabilities = [effect["probability"] for effect in content["effects"]]
    assert [effect["id"] for effect in content["effects"][-2:]] == ["none", "unknown"]
    assert len({tuple(effect) for effect in content["effects"]}) == 1, "rows have the same keys"
    assert content["shrinkage"].keys() >= {"held_out_cycles", "held_out_speed"}
    assert {which: own.keys() for which, own in content["mae_Nm"].items()} == dict.fromkeys(
        ("before", "after", "floor"), dict.fromkeys((*COORDINATES, "mean")).keys()
    )
    assert sum(probabilities) == pytest.approx(1.0)


def test_what_a_named_effect_says(written, subject):
    content = _content(written("named", subject))
    assert content["named"] == [ORTHOSIS] and content["credible_set"] == [ORTHOSIS, CENTER]
    first = content["effects"][0]
    assert first["evidence_nats"] == 31.0 and first["detectability"] == 7.2 and first["decision"]
    (effect_size,) = first["parameters"]
    assert effect_size == {"name": "dorsiflexion_stiffness", "value": 1.9, "sd": 0.3, "unit": "N m/deg"}
    assert content["explainable_share"] == {"estimate": 0.61, "ci95": [0.52, 0.7], "reason": None}
    shrinkage = content["shrinkage"]
    assert shrinkage["held_out_cycles"]["estimate"] == 0.48
    assert shrinkage["held_out_speed"]["ci95"] == pytest.approx([0.28, 0.6])
    assert content["not_testable"] == [{"id": "cop_offset", "reason": "there are no ground forces"}]
    assert content["advice"][0].items() >= {"splits": [ORTHOSIS, CENTER], "minutes": 3}.items()
    assert content["withheld"] == ["joint_damping"] and content["alarm_nats"] == 12.4
    assert content["trials"]["walk/01"] == {"use": "calibration", "speed_m_s": 0.5, "file": "walk"}


def test_a_ties_shrinkage_is_the_range_over_its_members(subject):
    content = describe_diagnosis(subject, ENDINGS["tie"]())
    cycles = content["shrinkage"]["held_out_cycles"]
    assert cycles["estimate"] == [0.41, 0.48]
    assert cycles["ci95"] == pytest.approx([0.32, 0.58])
    # One of the two cannot be told at the other speed.
    assert content["shrinkage"]["held_out_speed"]["estimate"] == pytest.approx([0.44, 0.44])


def test_what_cannot_be_told_is_null_with_a_reason(written, subject):
    for ending in SILENT:
        content = _content(written(ending, subject))
        assert content["where"] == [] and content["alternatives"] == []
        assert content["budget_Nm2"] is None and content["alarm_nats"] is None
        assert content["explainable_share"] == {"estimate": None, "ci95": None, "reason": "too few cycles"}
        assert content["shrinkage"]["held_out_cycles"]["estimate"] is None
        assert content["shrinkage"]["held_out_cycles"]["reason"] == "no effect was fitted"
        assert content["shrinkage"]["held_out_speed"] is None
        assert content["shrinkage"]["held_out_speed_reason"] == "no effect was fitted"
        assert set(content["mae_Nm"]["after"].values()) == set(content["mae_Nm"]["floor"].values()) == {None}
    assert _content(written("insufficient_data", subject))["mae_Nm"]["before"]["mean"] is None
    assert _content(written("not_converged", subject))["mae_Nm"]["before"]["mean"] > 0.0


def test_where_is_the_whole_grid_largest_first(subject):
    result = named()
    rows = where(result)
    places = {(row["coordinate"], tuple(row["phase_percent"]), row["speed_m_s"]) for row in rows}
    assert places == {
        (name, (5 * number, 5 * number + 5), speed)
        for name in COORDINATES
        for number in range(BINS)
        for speed in SPEEDS
    }
    assert len(rows) == len(places)
    shares = [row["share_of_gap"] for row in rows]
    assert shares == sorted(shares, reverse=True) and sum(shares) == pytest.approx(1.0)
    assert min(shares) >= 0.0
    # The largest is where the error was put, and its numbers are those of its own cycles.
    assert rows[0]["coordinate"] == "ankle_angle_l" and rows[0]["speed_m_s"] == 0.8
    assert rows[0]["phase_percent"] in ([25, 30], [30, 35])
    residual = (result.measured - result.plain)[result.speeds == 0.8, 2]
    start = rows[0]["phase_percent"][0] * 40 // 100
    rough = math.sqrt(np.mean(residual[:, start : start + 3] ** 2))
    assert rows[0]["rms_Nm"] == pytest.approx(rough, rel=0.05)
    for row in rows:
        share = row["explainable_rms_Nm"] ** 2 / np.sum(result.map**2)
        assert row["share_of_gap"] == pytest.approx(share)


def test_shares_of_nothing_are_null():
    rows = where(replace(named(), map=np.zeros((2, 3, BINS))))
    assert {row["explainable_rms_Nm"] for row in rows} == {0.0}
    assert all(math.isnan(row["share_of_gap"]) for row in rows)


def test_errors_before_after_and_of_noise_alone():
    """A residual of 2 N m, half of it taken away; noise of 3 N m is off by 2.39 N m on average."""
    result = named()
    plain = result.measured - 2.0
    first = replace(result.alternatives[0], predicted=plain + 1.0)
    zero = np.zeros((2, 3, BINS))
    budget = Budget(zero, zero, zero, zero, zero + 9.0)
    errors = mean_absolute_errors(replace(result, plain=plain, alternatives=(first,), budget=budget))
    assert errors["before"] == pytest.approx(dict.fromkeys((*COORDINATES, "mean"), 2.0))
    assert errors["after"] == pytest.approx(dict.fromkeys((*COORDINATES, "mean"), 1.0))
    draws = np.abs(np.random.default_rng(1).normal(scale=3.0, size=200_000)).mean()
    assert errors["floor"]["mean"] == pytest.approx(draws, rel=0.01)


def test_moments_read_back_as_they_were(written, subject):
    """Of all cycles of a recording, one after the other; where they meet, one frame."""
    result = named()
    table = read_storage(written("named", subject) / "moments" / "walk.sto")
    assert table.columns == tuple(
        f"{name}_moment{suffix}" for suffix in ("", "_before", "_after") for name in COORDINATES
    )
    assert (np.diff(table.time) > 0.0).all()
    for cycle in range(6):
        rows = np.searchsorted(table.time, result.time[cycle])
        np.testing.assert_array_equal(table.time[rows], result.time[cycle])
        expected = [result.measured[cycle], result.plain[cycle], result.alternatives[0].predicted[cycle]]
        np.testing.assert_array_equal(table.values[rows].T, np.concatenate(expected))
    joined = replace(result, time=np.linspace(np.arange(6.0), np.arange(6.0) + 1.0, 41, axis=1))
    assert len(moment_table(joined, "walk").time) == 6 * 40 + 1


@pytest.mark.parametrize(
    ("ending", "suffixes"),
    [("none", {"", "_before"}), ("not_converged", {"", "_before"}), ("insufficient_data", {""})],
)
def test_what_was_not_predicted_has_no_column(ending, suffixes, written, subject):
    table = read_storage(written(ending, subject) / "moments" / "walk.sto")
    assert set(table.columns) == {f"{name}_moment{suffix}" for name in COORDINATES for suffix in suffixes}


@pytest.mark.parametrize("ending", OUTCOMES)
def test_the_page_opens_offline_and_every_figure_can_be_read(ending, written, subject):
    text = (written(ending, subject) / "report.html").read_text()
    page = Page(text)
    for attributes in (attributes for _, attributes in page.elements):
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith("data:")
    assert "url(" not in text and "@import" not in text
    images = page.all("img")
    assert (
        len(images)
        == len(page.all("figcaption"))
        == {"none": 3, "unknown": 6, "tie": 7}.get(ending, 0 if ending in SILENT else 8)
    )
    for image in images:
        assert len(image["alt"]) > 20
        ElementTree.fromstring(base64.b64decode(image["src"].split(",", 1)[1]))
    assert "nan" not in re.findall(r"\w+", page.text.lower())
    assert "cause" not in page.text


def test_the_page_answers_in_order_what_a_reader_asks(written, subject):
    text = (written("named", subject) / "report.html").read_text()
    assert re.findall(r"<h2>(.*?)</h2>", text) == [
        "What this recording cannot test",
        "Where the error is",
        "What the error is made of",
        "What the model lacks, and what effects add",
        "Evidence for each effect",
        "How far the error shrinks",
        "Calibrated parameters that stood in for it",
        "What can be told apart",
        "Which muscles",
        "How far to trust it",
        "Notes",
    ]


def test_the_verdict_of_each_ending():
    said = {ending: " ".join(findings(make())) for ending, make in ENDINGS.items()}
    assert said["named"].startswith(
        "61 % [52\N{EN DASH}70] of the moment error (mean square) could be explained by a better model. Best "
        "explained, among the 5 effects testable with these data, by ankle foot orthosis (probability 0.62)."
    )
    assert (
        "Adding it removes 48 % [39\N{EN DASH}58] of the explainable error on cycles not used to fit it, "
        "44 % [28\N{EN DASH}60] at a speed not used to fit it."
    ) in said["named"]
    assert "Ankle foot orthosis: a brace or a shoe acts on the ankle like a spring." in said["named"]
    assert "Hip center offset: the hip's center lies elsewhere than in the model." in said["tie"]
    assert "falls most at ankle_angle_l, from 2.3 to 1.5 N m" in said["named"]
    assert "any of ankle foot orthosis (0.62), hip center offset (0.20)" in said["tie"]
    assert "Adding any one of them removes 41 to 48 %" in said["tie"]
    assert "none of the 5 effects testable with these data explains" in said["unknown"]
    assert "Nothing stands out" in said["none"] and "2 % [-6 to 11]" in said["none"]
    assert "too few gait cycles" in said["insufficient_data"]
    assert "Two calibration cycles at 0.8 m/s, where three are the fewest." in said["insufficient_data"]
    assert "not fitted as well as it can be" in said["not_converged"]
    assert not any("caus" in text.lower() for text in said.values())


def test_what_could_not_be_found_is_said():
    others = replace(named(), not_testable=(NotTestable("cop_offset", "no"), NotTestable("sync_lag", "no")))
    first, second = untested(others)
    assert first == "Cannot be tested with this recording: cop offset, sync lag."
    assert "joint damping" in second


def test_effects_that_would_not_show_do_not_count_as_tested():
    hidden = NotTestable("slow_fibers", "one of expected size would not show")
    text = findings(replace(named(), not_testable=(hidden,)))[0]
    assert "among the 4 effects testable with these data" in text


def test_only_shares_of_what_is_named_add_up():
    """Rivals that were fitted, too, explain the same error: stacked, they would explain it twice."""
    assert accepted_shares(named()) == {ORTHOSIS: 0.4}
    assert accepted_shares(replace(named(), named=(ORTHOSIS, CENTER))) == {ORTHOSIS: 0.4, CENTER: 0.1}
    assert accepted_shares(ENDINGS["tie"]()) == {}


def test_a_loud_negative_control_is_no_secret(subject):
    result = named()
    loud = finding("short_range_stiffness", 0.0, 30.0, negative_control=True)
    doubtful = replace(result, effects=(*result.effects[:-1], loud))
    assert "with doubt: short range stiffness" in findings(doubtful)[-1]
    assert "with doubt" not in " ".join(findings(result))
    assert "not quiet, 30.0 nats" in Page(render_diagnosis(subject, replace(doubtful, alternatives=()))).text


def test_two_effects_at_once_and_no_shrinkage_to_tell():
    result = named()
    both = replace(
        result.alternatives[0], ids=(ORTHOSIS, CENTER), held_out_cycles=Estimate.unknown("it may be 0")
    )
    text = " ".join(findings(replace(result, named=(ORTHOSIS, CENTER), alternatives=(both,))))
    assert "by ankle foot orthosis with hip center offset (probabilities 0.62 and 0.20)" in text
    assert "Adding it removes 44 % [28\N{EN DASH}60] of the explainable error at a speed" in text


def test_a_single_speed_that_is_not_given(subject):
    budget = named().budget
    parts = ("bias", "common", "specific", "driven", "noise")
    result = replace(
        named(),
        speeds=np.full(6, np.nan),
        budget_speeds=np.array([np.nan]),
        budget=Budget(**{name: getattr(budget, name)[:1] for name in parts}),
        map=named().map[:1],
        muscles=None,
    )
    text = Page(render_diagnosis(subject, result)).text
    assert "speed not given" in text


def test_the_band_is_students_interval_of_a_mean():
    curves = np.array([[1.0], [2.0], [4.0]])
    deviation = np.std([1.0, 2.0, 4.0], ddof=1)
    assert half_interval(curves) == pytest.approx(4.302653 * deviation / math.sqrt(3.0))
    assert np.isnan(half_interval(curves[:1]))


def test_effects_are_alike_only_if_each_can_imitate_the_other():
    """Slow fibers pass for the orthosis, but the orthosis not for slow fibers."""
    assert alike_pairs(*named().likeness) == [(ORTHOSIS, CENTER)]


def test_released_parameters_are_those_that_moved_farthest_first():
    labels = [one.label for one in most_released(named().alternatives[0])]
    assert labels[:2] == ["soleus_l.emg_scale", "gasmed_l.optimal_fiber_length"]
    assert len(labels) == MOST_RELEASED
    still = (Released("a.b", 0.3, 0.3, 1.0, False), Released("a.c", 0.3, 0.9, np.inf, False))
    assert most_released(replace(named().alternatives[0], released=still)) == []


def test_muscles_that_cannot_be_told_are_marked(subject):
    share = named().muscles
    assert resolved(share).tolist() == [True, True, True, False, False]
    text = render_diagnosis(subject, replace(named(), alternatives=(), budget=None))
    assert "the largest change that can be told is 240 N, of soleus_l" in Page(text).all("img")[-1]["alt"]


def test_what_an_effect_lacks_is_a_dash(subject):
    vague = finding("emg_drift", 0.9, np.nan, np.nan, effect_sizes=(EffectSize("gain", 0.2, np.nan, "1"),))
    text = Page(render_diagnosis(subject, replace(ENDINGS["none"](), effects=(vague,), budget=None))).text
    assert "gain 0.2" in text and "nan" not in re.findall(r"\w+", text)


def test_names_are_escaped(subject):
    result = replace(ENDINGS["not_converged"](), reason="a <b> & c")
    text = render_diagnosis(replace(subject, name="<i>"), result)
    assert "<i>" not in text and "A &lt;b&gt; &amp; c" in text


@pytest.mark.parametrize("ending", OUTCOMES)
def test_the_terminal_says_the_same(ending):
    text = diagnosis_table(ENDINGS[ending]())
    assert "cop offset" in text and "joint damping" in text
    assert "nan" not in re.findall(r"\w+", text.lower())
    assert ("ankle_foot_orthosis" in text) == (ending not in SILENT)


def test_an_existing_folder_is_refused_and_left_alone(subject, tmp_path):
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "mine.txt").write_text("precious")
    result = ENDINGS["not_converged"]()
    with pytest.raises(InputError, match="--force"):
        write_diagnosis(subject, result, tmp_path / "gap")
    assert _files(tmp_path) == ["gap/mine.txt"]
    write_diagnosis(subject, result, tmp_path / "gap", force=True)
    assert "mine.txt" not in _files(tmp_path / "gap") and (tmp_path / "gap" / "gap.json").is_file()


@pytest.mark.parametrize("writer", ["write_json", "write_storage", "render_gap"])
@pytest.mark.parametrize("force", [False, True])
def test_failing_half_way_leaves_nothing_and_takes_nothing(writer, force, subject, tmp_path, monkeypatch):
    def fail(*arguments, **options):
        raise OSError("disk full")

    if force:
        (tmp_path / "gap").mkdir()
        (tmp_path / "gap" / "old.txt").write_text("old")
    monkeypatch.setattr(gap_folder, writer, fail)
    with pytest.raises(OSError, match="disk full"):
        write_diagnosis(subject, ENDINGS["not_converged"](), tmp_path / "gap", force=force)
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == (
        ["gap", "gap/old.txt"] if force else []
    )
