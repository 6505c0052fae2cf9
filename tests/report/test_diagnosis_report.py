"""Tests of the folder of a diagnosis: keys of gap.json, a self-contained page, and its findings."""

import base64
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from tests.report.page import Page
from tests.report.synthetic_diagnosis import (
    CENTER,
    COORDINATES,
    ORTHOSIS,
    OUTCOME_MAKERS,
    SPEEDS,
    finding,
    insufficient_data,
    named,
    not_converged,
    partial,
)
from wrapjax import InputError
from wrapjax.diagnosis.claims.decision import OUTCOMES
from wrapjax.diagnosis.effects.effect import NotTestable
from wrapjax.diagnosis.fits.verification import ReleasedParameter
from wrapjax.diagnosis.localization import BINS, ErrorBudget
from wrapjax.diagnosis.null_hypotheses.noise_floor import Estimate
from wrapjax.diagnosis.null_hypotheses.undriven_capacity import CapacityShare
from wrapjax.diagnosis.result import EffectSize
from wrapjax.io.storage import read_storage
from wrapjax.report.diagnosis import page as diagnosis_page
from wrapjax.report.diagnosis.effects import alike_pairs, half_interval
from wrapjax.report.diagnosis.location import resolved
from wrapjax.report.diagnosis.numbers import (
    describe_diagnosis,
    error_locations,
    mean_absolute_errors,
    moment_table,
)
from wrapjax.report.diagnosis.page import render_diagnosis, write_diagnosis
from wrapjax.report.diagnosis.shrinkage import MOST_RELEASED, accepted_shares, most_released
from wrapjax.report.diagnosis.words import diagnosis_findings, diagnosis_text, gate_rows, untested_findings

#: Keys that gap.json always has.
KEYS = {
    *("schema", "outcome", "named", "ties", "credible_set", "effects", "where", "explainable_share"),
    *("shrinkage", "mae_Nm", "not_testable", "advice"),
    *("best_partial", "family", "credible_families", "gates", "muscle_law", "undriven_capacity"),
}
INCONCLUSIVE = ("insufficient_data", "not_converged")


def _refuse(constant):
    raise AssertionError(f"{constant} is not JSON")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write the folder of each outcome once, because drawing is slow."""
    folders = {}

    def write(outcome, subject):
        if outcome not in folders:
            folders[outcome] = tmp_path_factory.mktemp("diagnoses") / outcome
            write_diagnosis(subject, OUTCOME_MAKERS[outcome](), folders[outcome])
        return folders[outcome]

    return write


def _content(folder):
    return json.loads((folder / "gap.json").read_text(), parse_constant=_refuse)


def _files(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_every_outcome_has_a_synthetic_diagnosis():
    assert set(OUTCOME_MAKERS) == set(OUTCOMES)


@pytest.mark.parametrize("outcome", OUTCOMES)
def test_folder_contains_exactly_the_documented_files(outcome, written, subject):
    folder = written(outcome, subject)
    assert _files(folder) == ["gap.json", "moments/walk.sto", "report.html"]


@pytest.mark.parametrize("outcome", OUTCOMES)
def test_every_outcome_has_the_guaranteed_keys(outcome, written, subject):
    content = _content(written(outcome, subject))
    assert content.keys() >= KEYS
    assert content["schema"] == 2 and content["outcome"] == outcome
    probabilities = [effect["probability"] for effect in content["effects"]]
    assert [effect["id"] for effect in content["effects"][-2:]] == ["none", "unknown"]
    assert len({tuple(effect) for effect in content["effects"]}) == 1, "rows have the same keys"
    assert content["shrinkage"].keys() >= {"held_out_cycles", "held_out_speed"}
    assert {which: own.keys() for which, own in content["mae_Nm"].items()} == dict.fromkeys(
        ("before", "after", "floor"), dict.fromkeys((*COORDINATES, "mean")).keys()
    )
    assert sum(probabilities) == pytest.approx(1.0)


def test_content_for_a_named_effect(written, subject):
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


def test_shrinkage_of_a_tie_is_the_range_over_its_members(subject):
    content = describe_diagnosis(subject, OUTCOME_MAKERS["tie"]())
    cycles = content["shrinkage"]["held_out_cycles"]
    assert cycles["estimate"] == [0.41, 0.48]
    assert cycles["ci95"] == pytest.approx([0.32, 0.58])
    # One of the two has no estimate at the held-out speed.
    assert content["shrinkage"]["held_out_speed"]["estimate"] == pytest.approx([0.44, 0.44])


def test_unknown_values_are_null_with_a_reason(written, subject):
    for outcome in INCONCLUSIVE:
        content = _content(written(outcome, subject))
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


def test_error_locations_cover_the_grid_largest_first(subject):
    result = named()
    rows = error_locations(result)
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
    # The largest error is where it was added, computed from the cycles of that speed.
    assert rows[0]["coordinate"] == "ankle_angle_l" and rows[0]["speed_m_s"] == 0.8
    assert rows[0]["phase_percent"] in ([25, 30], [30, 35])
    residual = (result.measured - result.plain)[result.speeds == 0.8, 2]
    start = rows[0]["phase_percent"][0] * 40 // 100
    rough = math.sqrt(np.mean(residual[:, start : start + 3] ** 2))
    assert rows[0]["rms_Nm"] == pytest.approx(rough, rel=0.05)
    for row in rows:
        share = row["explainable_rms_Nm"] ** 2 / np.sum(result.error_map**2)
        assert row["share_of_gap"] == pytest.approx(share)


def test_shares_of_zero_error_are_nan():
    rows = error_locations(replace(named(), error_map=np.zeros((2, 3, BINS))))
    assert {row["explainable_rms_Nm"] for row in rows} == {0.0}
    assert all(math.isnan(row["share_of_gap"]) for row in rows)


def test_mean_absolute_errors_before_after_and_of_noise():
    """A residual of 2 N m is halved; noise with SD 3 N m has a mean absolute value of 2.39 N m."""
    result = named()
    plain = result.measured - 2.0
    first = replace(result.refits[0], predicted=plain + 1.0)
    zero = np.zeros((2, 3, BINS))
    budget = ErrorBudget(zero, zero, zero, zero, zero + 9.0)
    errors = mean_absolute_errors(replace(result, plain=plain, refits=(first,), budget=budget))
    assert errors["before"] == pytest.approx(dict.fromkeys((*COORDINATES, "mean"), 2.0))
    assert errors["after"] == pytest.approx(dict.fromkeys((*COORDINATES, "mean"), 1.0))
    draws = np.abs(np.random.default_rng(1).normal(scale=3.0, size=200_000)).mean()
    assert errors["floor"]["mean"] == pytest.approx(draws, rel=0.01)


def test_stored_moments_are_read_back_exactly(written, subject):
    """The table has all cycles of a recording in sequence, with one frame where two cycles meet."""
    result = named()
    table = read_storage(written("named", subject) / "moments" / "walk.sto")
    assert table.columns == tuple(
        f"{name}_moment{suffix}" for suffix in ("", "_before", "_after") for name in COORDINATES
    )
    assert (np.diff(table.time) > 0.0).all()
    for cycle in range(6):
        rows = np.searchsorted(table.time, result.time[cycle])
        np.testing.assert_array_equal(table.time[rows], result.time[cycle])
        expected = [result.measured[cycle], result.plain[cycle], result.refits[0].predicted[cycle]]
        np.testing.assert_array_equal(table.values[rows].T, np.concatenate(expected))
    joined = replace(result, time=np.linspace(np.arange(6.0), np.arange(6.0) + 1.0, 41, axis=1))
    assert len(moment_table(joined, "walk").time) == 6 * 40 + 1


@pytest.mark.parametrize(
    ("outcome", "suffixes"),
    [("none", {"", "_before"}), ("not_converged", {"", "_before"}), ("insufficient_data", {""})],
)
def test_unpredicted_moments_have_no_column(outcome, suffixes, written, subject):
    table = read_storage(written(outcome, subject) / "moments" / "walk.sto")
    assert set(table.columns) == {f"{name}_moment{suffix}" for name in COORDINATES for suffix in suffixes}


@pytest.mark.parametrize("outcome", OUTCOMES)
def test_page_is_self_contained_with_valid_figures(outcome, written, subject):
    text = (written(outcome, subject) / "report.html").read_text()
    page = Page(text)
    for attributes in (attributes for _, attributes in page.elements):
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith("data:")
    assert "url(" not in text and "@import" not in text
    images = page.all("img")
    assert (
        len(images)
        == len(page.all("figcaption"))
        == {"none": 3, "unknown": 6, "tie": 7, "family": 7}.get(outcome, 0 if outcome in INCONCLUSIVE else 8)
    )
    for image in images:
        assert len(image["alt"]) > 20
        ElementTree.fromstring(base64.b64decode(image["src"].split(",", 1)[1]))
    assert "nan" not in re.findall(r"\w+", page.text.lower())
    assert not re.search(r"\bcaus", page.text.lower())


def test_gates_and_families_are_numbers(written, subject):
    content = _content(written("family", subject))
    assert content["family"] == {"id": "device", "probability": 0.62, "members": [ORTHOSIS]}
    assert content["gates"]["adequate"] == {"passed": True, "left_rms_Nm": 2.1, "floor_rms_Nm": 2.6}
    assert content["gates"]["plausible"]["worst"]["limit"] == 4.5
    assert content["gates"]["stable"]["passed"] is False and content["gates"]["stable"]["agreement"] == 0.5
    assert content["gates"]["specific"] == {"passed": True, "shrinkage": 0.48, "sham_shrinkage": 0.21}
    failed = describe_diagnosis(subject, partial())
    assert failed["best_partial"] == (ORTHOSIS,) and failed["family"] is None
    assert [gate["passed"] for gate in failed["gates"].values()] == [False, False, True, True]
    asked = _content(written("none", subject))["gates"]
    assert asked["adequate"]["passed"] is True, "asked of the plain model"
    assert asked["stable"] == {"passed": None, "agreement": None}
    for outcome in INCONCLUSIVE:
        gates = _content(written(outcome, subject))["gates"]
        assert gates.keys() == asked.keys() and not any(gate["passed"] for gate in gates.values())


def test_the_page_says_why_a_refused_effect_is_improbable(subject):
    said = "Since a gate refuses the strongest effect"
    assert said in render_diagnosis(subject, partial())
    assert said not in render_diagnosis(subject, named())


def test_reasons_have_names_of_effects_as_words():
    sentences = diagnosis_findings(partial())
    assert "With ankle foot orthosis a repeatable error of 3.1 N m is left." in sentences
    (row,) = (figure for name, _, figure, _ in gate_rows(partial()) if name == "plausible")
    assert row == "ankle foot orthosis: dorsiflexion stiffness 4.5; limit 4.5 N m/deg"


def test_the_page_shows_the_gates(written, subject):
    for outcome, results in (
        ("named", ["passed"] * 4),
        ("family", ["passed", "passed", "failed", "passed"]),
        ("none", ["passed"]),
        ("not_converged", []),
    ):
        text = (written(outcome, subject) / "report.html").read_text()
        assert re.findall(r"<td>(passed|failed)</td>", text) == results


def test_order_of_sections(written, subject):
    text = (written("named", subject) / "report.html").read_text()
    assert re.findall(r"<h2>(.*?)</h2>", text) == [
        "What a name has to pass",
        "Evidence for each effect",
        "Shrinkage of the error",
        "Calibrated parameters that compensated for the missing effect",
        "Which effects can be distinguished",
        "Location of the error",
        "Parts of the error",
        "Moment error, and moments added by effects",
        "Muscle forces that would remove the error",
        "Effects that this recording cannot test",
        "Muscle law of the person",
        "Convergence and detection threshold",
        "Notes",
    ]


def test_a_decrease_at_one_coordinate_alone_is_not_stated():
    """The named effect lowers the error of the first coordinate, but not the mean over coordinates."""
    result = named()
    plain = np.array(result.measured)
    plain[:, 0] += 1.01 * np.abs(result.refits[0].predicted - result.measured)[:, 0].max()
    said = " ".join(diagnosis_findings(replace(result, plain=plain)))
    assert "explained" in said and "decreases most" not in said


def test_findings_of_each_outcome():
    said = {outcome: " ".join(diagnosis_findings(make())) for outcome, make in OUTCOME_MAKERS.items()}
    assert said["named"].startswith(
        "A better model could explain 61 % [52\N{EN DASH}70] of the moment error (mean square). The error is "
        "best explained, among the 5 effects testable with these data, by ankle foot orthosis (probability "
        "0.62)."
    )
    assert (
        "Adding it removes 48 % [39\N{EN DASH}58] of the explainable error on held-out cycles and "
        "44 % [28\N{EN DASH}60] at a held-out speed."
    ) in said["named"]
    assert "Ankle foot orthosis: a brace or a shoe acts on the ankle like a spring." in said["named"]
    assert "Hip center offset: the hip's center lies elsewhere than in the model." in said["tie"]
    assert "decreases most at ankle_angle_l, from 2.3 to 1.5 N m" in said["named"]
    assert "any of ankle foot orthosis (0.62), hip center offset (0.20)" in said["tie"]
    assert "Adding any one of them removes 41 to 48 %" in said["tie"]
    assert "none of the 5 effects testable with these data explains" in said["unknown"]
    assert "by an effect of one family: a device acts on the leg (probability 0.62)" in said["family"]
    assert (
        "does not exceed that expected without any effect" in said["none"]
        and "2 % [-6 to 11]" in said["none"]
    )
    assert "too few gait cycles" in said["insufficient_data"]
    assert "Two calibration cycles at 0.8 m/s, where three are the fewest." in said["insufficient_data"]
    assert "calibration of the plain model did not converge" in said["not_converged"]
    assert not any(re.search(r"\bcaus", text.lower()) for text in said.values())


def test_too_few_cycles_are_not_reported_as_a_fit_that_did_not_converge(subject):
    """With too few cycles the check of convergence is not made, and lists why."""
    for make, said in (
        (insufficient_data, "The convergence of the plain model was not examined:"),
        (not_converged, "The calibration of the plain model did not converge:"),
    ):
        result = make()
        check = replace(result.convergence_check, problems=("1 calibration cycle at one speed",))
        page = render_diagnosis(subject, replace(result, convergence_check=check))
        assert said in page
        assert page.count("was not examined:") + page.count("did not converge:") == 1


def test_untested_effects_are_stated():
    lacking, weak = (
        (NotTestable("cop_offset", ""), NotTestable("sync_lag", "")),
        NotTestable("slow_fibers", ""),
    )
    first, second, third = untested_findings(replace(named(), not_testable=lacking, undetectable=(weak,)))
    assert first == "Not testable, as the subject or the recording lacks something: cop offset, sync lag."
    assert second == "Not detectable with this recording at the usual size: slow fibers."
    assert "joint damping" in third


def test_a_coordinate_with_few_electrodes_is_stated():
    result = named()
    name = result.coordinates[0]
    few = {**result.undriven_capacity, name: CapacityShare(0.8, 0.7, 0.73)}
    said = [" ".join(diagnosis_findings(one)) for one in (result, replace(result, undriven_capacity=few))]
    assert "Muscles without EMG" not in said[0] and f"capacity (73 % at {name}):" in said[1]


def test_undetectable_effects_do_not_count_as_tested():
    hidden = NotTestable("slow_fibers", "one of expected size would not show")
    text = diagnosis_findings(replace(named(), undetectable=(hidden,)))[0]
    assert "among the 4 effects testable with these data" in text


def test_only_shares_of_named_effects_are_added():
    """Other refitted effects explain the same error and must not be added."""
    assert accepted_shares(named()) == {ORTHOSIS: 0.4}
    assert accepted_shares(replace(named(), named=(ORTHOSIS, CENTER))) == {ORTHOSIS: 0.4, CENTER: 0.1}
    assert accepted_shares(OUTCOME_MAKERS["tie"]()) == {}


def test_a_negative_control_above_the_threshold_is_reported(subject):
    result = named()
    loud = finding("short_range_stiffness", 0.0, 30.0, negative_control=True)
    doubtful = replace(result, effects=(*result.effects[:-1], loud))
    assert "unreliable: the evidence for short range stiffness" in diagnosis_findings(doubtful)[-1]
    assert "unreliable" not in " ".join(diagnosis_findings(result))
    assert "above threshold, 30.0 nats" in Page(render_diagnosis(subject, replace(doubtful, refits=()))).text


def test_two_named_effects_without_shrinkage_on_held_out_cycles():
    result = named()
    both = replace(result.refits[0], ids=(ORTHOSIS, CENTER), held_out_cycles=Estimate.unknown("it may be 0"))
    text = " ".join(diagnosis_findings(replace(result, named=(ORTHOSIS, CENTER), refits=(both,))))
    assert "by ankle foot orthosis with hip center offset (probabilities 0.62 and 0.20)" in text
    assert "Adding them removes 44 % [28\N{EN DASH}60] of the explainable error at a held-out speed" in text


def test_a_single_unknown_speed(subject):
    budget = named().budget
    parts = ("bias", "common", "specific", "driven", "noise")
    result = replace(
        named(),
        speeds=np.full(6, np.nan),
        budget_speeds=np.array([np.nan]),
        budget=ErrorBudget(**{name: getattr(budget, name)[:1] for name in parts}),
        error_map=named().error_map[:1],
        muscle_share=None,
    )
    text = Page(render_diagnosis(subject, result)).text
    assert "speed not given" in text


def test_half_interval_is_students_confidence_interval():
    curves = np.array([[1.0], [2.0], [4.0]])
    deviation = np.std([1.0, 2.0, 4.0], ddof=1)
    assert half_interval(curves) == pytest.approx(4.302653 * deviation / math.sqrt(3.0))
    assert np.isnan(half_interval(curves[:1]))


def test_effects_are_alike_only_if_each_can_reproduce_the_other():
    """Slow fibers reproduce the orthosis, but the orthosis does not reproduce slow fibers."""
    assert alike_pairs(*named().distinguishability) == [(ORTHOSIS, CENTER)]


def test_released_parameters_are_ordered_by_their_change():
    labels = [one.label for one in most_released(named().refits[0])]
    assert labels[:2] == ["soleus_l.emg_scale", "gasmed_l.optimal_fiber_length"]
    assert len(labels) == MOST_RELEASED
    unchanged = ReleasedParameter("a.b", 0.3, 0.3, 1.0, False)
    without_prior = ReleasedParameter("a.c", 0.3, 0.9, np.inf, False)
    assert most_released(replace(named().refits[0], released=(unchanged, without_prior))) == []


def test_muscles_that_are_not_identifiable_are_marked(subject):
    share = named().muscle_share
    assert resolved(share).tolist() == [True, True, True, False, False]
    text = render_diagnosis(subject, replace(named(), refits=(), budget=None))
    assert "the largest identifiable change is 240 N, of soleus_l" in Page(text).all("img")[-1]["alt"]


def test_missing_values_of_an_effect_are_dashes(subject):
    vague = finding("emg_drift", 0.9, np.nan, np.nan, effect_sizes=(EffectSize("gain", 0.2, np.nan, "1"),))
    text = Page(
        render_diagnosis(subject, replace(OUTCOME_MAKERS["none"](), effects=(vague,), budget=None))
    ).text
    assert "gain 0.2" in text and "nan" not in re.findall(r"\w+", text)


def test_names_are_escaped(subject):
    result = replace(OUTCOME_MAKERS["not_converged"](), reason="a <b> & c")
    text = render_diagnosis(replace(subject, name="<i>"), result)
    assert "<i>" not in text and "A &lt;b&gt; &amp; c" in text


@pytest.mark.parametrize("outcome", OUTCOMES)
def test_terminal_output_names_the_same_effects(outcome):
    text = diagnosis_text(OUTCOME_MAKERS[outcome]())
    assert "cop offset" in text and "joint damping" in text
    assert "nan" not in re.findall(r"\w+", text.lower())
    assert ("ankle_foot_orthosis" in text) == (outcome not in INCONCLUSIVE)


def test_an_existing_folder_is_refused_and_unchanged(subject, tmp_path):
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "mine.txt").write_text("precious")
    result = OUTCOME_MAKERS["not_converged"]()
    with pytest.raises(InputError, match="--force"):
        write_diagnosis(subject, result, tmp_path / "gap")
    assert _files(tmp_path) == ["gap/mine.txt"]
    write_diagnosis(subject, result, tmp_path / "gap", force=True)
    assert "mine.txt" not in _files(tmp_path / "gap") and (tmp_path / "gap" / "gap.json").is_file()


@pytest.mark.parametrize("writer", ["write_json", "write_storage", "render_diagnosis"])
@pytest.mark.parametrize("force", [False, True])
def test_a_failed_write_leaves_no_folder_and_keeps_an_existing_one(
    writer, force, subject, tmp_path, monkeypatch
):
    def fail(*arguments, **options):
        raise OSError("disk full")

    if force:
        (tmp_path / "gap").mkdir()
        (tmp_path / "gap" / "old.txt").write_text("old")
    monkeypatch.setattr(diagnosis_page, writer, fail)
    with pytest.raises(OSError, match="disk full"):
        write_diagnosis(subject, OUTCOME_MAKERS["not_converged"](), tmp_path / "gap", force=force)
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == (
        ["gap", "gap/old.txt"] if force else []
    )


def test_nothing_is_said_of_refits_where_there_are_none():
    """As where all fitted effects are not testable."""
    assert any("removes" in sentence for sentence in diagnosis_findings(partial()))
    assert not any(
        "removes" in sentence or "decreases" in sentence
        for sentence in diagnosis_findings(replace(partial(), refits=()))
    )


def test_the_report_shows_the_muscle_law_and_the_evidence_for_published_ones(subject, written):
    folder = written("named", subject)
    page = (folder / "report.html").read_text(encoding="utf-8")
    section = page[page.index("Muscle law of the person") :]
    # The best first.
    assert section.index("3.2") < section.index("-12.0")
    assert "active_width_short" in section and "10.1115/1.1531112" in section
    law = json.loads((folder / "gap.json").read_text(encoding="utf-8"))["muscle_law"]
    assert law["evidence_nats"] == {"nmsm": -12.0, "thelen": 3.25}
    assert law["parameters"]["second_stage"] == 0.125
