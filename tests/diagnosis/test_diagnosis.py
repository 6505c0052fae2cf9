"""Complete diagnoses on data of the model's own form: a unit test, which says nothing about accuracy."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial

from wrapjax import InputError
from wrapjax.datasets.virtual_person.hidden_effects import HIDDEN_EFFECTS
from wrapjax.demonstration.demo import EXCLUDED_EFFECTS, demonstrate_diagnosis
from wrapjax.diagnosis import diagnosis, pipeline
from wrapjax.diagnosis.claims import decision
from wrapjax.diagnosis.claims.claim import examine_claim
from wrapjax.diagnosis.diagnosis import diagnose, diagnose_calibrated
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, effect_meanings, register_effect
from wrapjax.diagnosis.effects.definition import EffectDefinition
from wrapjax.diagnosis.effects.effect import EffectParameter, Effects, Variant
from wrapjax.diagnosis.evidence import score
from wrapjax.diagnosis.evidence.score import Scores
from wrapjax.model.alteration import Alteration

#: Few effects, which compile fast.
SCORED = {"joint_damping", "emg_drift"}
#: The leg has no ground reaction forces, which the last two need; curves and joint centers are nuisances.
KEPT = SCORED | {"curve_family", "cop_offset", "joint_center_spread"}
WITHOUT = sorted(set(CATALOGUE) - KEPT)


@pytest.fixture(scope="module")
def gap(calibrated):
    return diagnose_calibrated(calibrated, without=WITHOUT, null_replicates=2).result


@pytest.mark.slow
def test_too_few_cycles_end_the_diagnosis(gap):
    """Of three cycles one is for validation."""
    assert gap.outcome == "insufficient_data" and not gap.named and not gap.effects
    assert "fewest" in gap.reason
    assert np.isfinite(gap.plain).all() and gap.unknown_probability == 1.0


@pytest.mark.slow
def test_nuisances_are_not_listed_among_what_is_not_testable(gap):
    assert {entry.id for entry in gap.not_testable} == {"cop_offset"}


def test_unknown_effects_are_refused_before_any_work(person, paths):
    with pytest.raises(InputError, match="joint_damping"):
        diagnose(person, "NGA", paths, without=["joint_dampin"])


@pytest.fixture(scope="module")
def several(person):
    """The person with seven cycles at two speeds, six of them for calibration."""
    generator = np.random.default_rng(0)
    places = np.resize(np.arange(len(person.trials)), 7)
    many = person.trials.select(places)
    phase = np.linspace(0.0, 2.0 * np.pi, many.moments.shape[-1])
    waves = np.stack([np.ones_like(phase), np.sin(phase), np.cos(phase), np.sin(2.0 * phase)])
    noise = generator.normal(size=(*many.moments.shape[:2], 4)) @ waves
    names = tuple(f"walk/{number:02d}" for number in range(7))
    trials = dataclasses.replace(
        many,
        names=names,
        recordings=("walk",) * 7,
        uses=("calibration",) * 6 + ("validation",),
        speeds=np.array([0.8, 0.8, 0.8, 1.2, 1.2, 1.2, 0.8]),
        time=many.time + 10.0 * np.arange(7)[:, None],
        emg_time=many.emg_time + 10.0 * np.arange(7)[:, None],
        emg=many.emg * np.exp(0.05 * generator.normal(size=(*many.emg.shape[:2], 1))),
        moments=many.moments + noise,
    )
    return dataclasses.replace(person, trials=trials)


@pytest.fixture(scope="module")
def found(several, paths):
    return diagnose(several, "NGA", paths, without=WITHOUT, starts=2, null_replicates=4)


def test_a_diagnosis_is_complete(found, several, tmp_path):
    result = found.result
    assert result.outcome in ("named", "tie", "none", "unknown")
    assert {effect.id for effect in result.effects} == SCORED
    total = sum(effect.probability for effect in result.effects)
    assert total + result.none_probability + result.unknown_probability == pytest.approx(1.0)
    by_evidence = sorted(result.effects, key=lambda effect: -effect.evidence)
    assert list(result.effects) == by_evidence, "effects are ranked by the evidence of the score test only"
    assert result.convergence_check.holds and result.convergence_check.conflicts["by_half"]
    dataset = found.to_dataset()
    assert set(dataset["effect"].values) == SCORED and dataset.attrs["outcome"] == result.outcome
    np.testing.assert_array_equal(dataset["predicted_moment"].sel(model="plain"), result.plain)
    held = result.measured - result.plain
    baseline = found.independent.baseline
    seen = result.measured - found.data.prediction(Effects(()))(baseline.variables, np.zeros(0))
    calibrated = np.array(result.uses) == "calibration"
    # Errors on held-out cycles are larger than on fitted ones.
    assert (held[calibrated] ** 2).mean() > (seen[calibrated] ** 2).mean()
    found.save(tmp_path / "gap")
    content = json.loads((tmp_path / "gap" / "gap.json").read_text())
    assert content["withheld"] == WITHOUT and len(content["where"]) == 2 * 2 * 20
    with pytest.raises(InputError, match="exists"):
        found.save(tmp_path / "gap")


def test_withholding_an_effect_afterwards_or_at_once_gives_the_same_result(found):
    withheld = (*WITHOUT, "emg_drift")
    afterwards = found.without(*withheld).result
    at_once = diagnose_calibrated(found.calibration, without=withheld, null_replicates=4).result
    assert afterwards.withheld == at_once.withheld == withheld
    assert [one.id for one in afterwards.effects] == ["joint_damping"]
    assert afterwards.effects == at_once.effects
    for one, other in zip(afterwards.refits, at_once.refits, strict=True):
        assert one.held_out_cycles == other.held_out_cycles
        np.testing.assert_array_equal(one.predicted, other.predicted)
    with pytest.raises(InputError, match="joint_damping"):
        found.without("joint_dampin")


def spring(context):
    """A moment of 1 N m/rad times the size against the first coordinate, about its mean."""
    basis = np.zeros((1, *context.angles.shape))
    basis[0, :, 0] = context.reference.angles[:, 0].mean() - context.angles[:, 0]
    return (Variant(Partial(stretched, jnp.asarray(basis))),)


def stretched(basis, sizes):
    return Alteration(moment=jnp.tensordot(sizes, basis, axes=1))


BRACE = EffectDefinition(
    id="knee_brace",
    meaning="a brace acts like a spring",
    family="device",
    parameters=(EffectParameter("stiffness", "N m/rad", 20.0, 1, "stiffness", "bench test", limit=100.0),),
    variants=spring,
)


def test_an_effect_of_ones_own_is_scored_fitted_and_reported(found, monkeypatch, tmp_path):
    """The evidence of the others stays."""
    monkeypatch.setitem(CATALOGUE, "knee_brace", BRACE)
    register_effect(BRACE)
    assert effect_meanings()["knee_brace"] == BRACE.meaning
    monkeypatch.setattr(pipeline, "effects_to_refit", lambda _: [("knee_brace",)])
    again = found.without(*WITHOUT)
    evidence, before = ({one.id: one.evidence for one in of.result.effects} for of in (again, found))
    assert evidence.keys() == SCORED | {"knee_brace"}
    assert {id: evidence[id] for id in SCORED} == pytest.approx(before, rel=1e-9)
    assert [refit.ids for refit in again.result.refits] == [("knee_brace",)]
    again.save(tmp_path / "gap")
    content = json.loads((tmp_path / "gap" / "gap.json").read_text())
    (own,) = (one for one in content["effects"] if one["id"] == "knee_brace")
    assert own["parameters"][0]["unit"] == "N m/rad"
    assert "knee brace" in (tmp_path / "gap" / "report.html").read_text().lower()


@pytest.mark.parametrize("id", ["joint_damping", "unknown", "knee brace"])
def test_an_effect_of_ones_own_needs_a_name_of_its_own(id):
    with pytest.raises(ValueError, match=f"'{id}' cannot name"):
        register_effect(dataclasses.replace(BRACE, id=id))
    with pytest.raises(ValueError, match="there is no family 'brace'"):
        register_effect(dataclasses.replace(BRACE, family="brace"))


@pytest.mark.parametrize("refused", [(), ("emg_drift",)])
def test_nothing_is_both_fitted_or_ranked_and_not_testable(found, monkeypatch, tmp_path, refused):
    """With a limit that no effect reaches; but the fit of a claim that was refused is shown."""
    monkeypatch.setattr("wrapjax.diagnosis.result.MIN_DETECTABILITY", np.inf)
    changes = {"outcome": "unknown", "named": (), "tie": (), "best_partial": refused}
    monkeypatch.setattr(
        pipeline, "examine_claim", lambda *arguments: dataclasses.replace(arguments[5], **changes)
    )
    monkeypatch.setattr(pipeline, "effects_to_refit", lambda _: [(id,) for id in sorted(SCORED)])
    again = found.without(*WITHOUT)
    hidden = {entry.id for entry in again.result.undetectable}
    assert ("emg_drift" in hidden) == (not refused)
    assert {id for one in again.result.refits for id in one.ids} == SCORED - hidden
    again.save(tmp_path / "gap")
    content = json.loads((tmp_path / "gap" / "gap.json").read_text())
    ranked, untested = ({one["id"] for one in content[key]} for key in ("effects", "not_testable"))
    assert {one["id"] for one in content["undetectable"]} == hidden <= ranked
    assert untested and not untested & ranked


def test_a_refused_claim_is_not_probable(found, monkeypatch):
    """The effect with the largest evidence keeps its place, but is no more probable than none of them."""
    strong = {"joint_damping": 40.0, "emg_drift": 30.0}
    monkeypatch.setattr(Scores, "evidence", property(lambda _: strong))
    result = found.without(*WITHOUT).result
    assert result.outcome == "unknown" and result.best_partial
    shares = {effect.id: effect.probability for effect in result.effects}
    assert 0.5 > shares["joint_damping"] > shares["emg_drift"] > 0.1
    assert "none_of_these" in result.credible_set


def test_several_effects_are_refitted_together_and_share_the_shrinkage(found, monkeypatch, tmp_path):
    """Joint significance, improvement and the gates are assumed here."""
    both = ("joint_damping", "emg_drift")
    monkeypatch.setattr(score, "jointly_significant_effects", lambda *_: both)
    monkeypatch.setattr(decision, "may_name_jointly", lambda *_: True)
    monkeypatch.setattr(decision, "each_effect_improves", lambda *_: True)
    monkeypatch.setattr(pipeline, "examine_claim", lambda *arguments: arguments[5])
    named = found.without(*WITHOUT)
    result = named.result
    assert result.outcome == "named" and result.named == both and not result.ties
    fitted = {one.ids: one for one in result.refits}
    assert result.refits[0].ids == both and {both[:1], both[1:]} < set(fitted)
    if fitted[both].held_out_cycles.known:
        assert sum(result.shares.values()) == pytest.approx(fitted[both].held_out_cycles.value)
    named.save(tmp_path / "gap")
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["named"] == list(both)
    assert "joint damping with emg drift" in (tmp_path / "gap" / "report.html").read_text()
    monkeypatch.setattr(decision, "each_effect_improves", lambda *_: False)
    monkeypatch.setattr(pipeline, "examine_claim", examine_claim)
    assert found.without(*WITHOUT).result.named == found.result.named


def test_a_fit_that_has_not_converged_ends_the_diagnosis(found):
    """The costs of its starts differ too much."""
    calibration = found.calibration
    result = calibration.result
    worse = dataclasses.replace(result.outcomes[1].solution, cost=1.5 * result.solution.cost)
    outcomes = (result.outcomes[0], dataclasses.replace(result.outcomes[1], solution=worse))
    apart = dataclasses.replace(calibration, result=dataclasses.replace(result, outcomes=outcomes, chosen=0))
    stopped = diagnose_calibrated(apart, without=WITHOUT, null_replicates=1).result
    assert stopped.outcome == "not_converged" and "apart" in stopped.reason
    assert not stopped.effects and stopped.budget is not None


def test_more_starts_are_made_until_the_two_best_agree(found, paths, monkeypatch):
    calibration = found.calibration
    asked = []

    def calibrated(*_, starts, **__):
        asked.append(starts)
        best = calibration.result.outcomes[0]
        factors = (1.0, *([1.5] * (starts - 1))) if starts < 8 else (1.0,) * starts
        outcomes = tuple(
            dataclasses.replace(
                best, solution=dataclasses.replace(best.solution, cost=factor * best.solution.cost)
            )
            for factor in factors
        )
        result = dataclasses.replace(calibration.result, outcomes=outcomes, chosen=0)
        return dataclasses.replace(calibration, result=result)

    monkeypatch.setattr(diagnosis, "cached_calibration", calibrated)
    monkeypatch.setattr(
        diagnosis, "diagnose_calibrated", lambda one, **_: dataclasses.replace(found, calibration=one)
    )
    lines = []
    chosen = diagnose(calibration.subject, "NGA", paths, starts=2, log=lines.append)
    assert asked == [2, 4, 8] and len(chosen.calibration.result.outcomes) == 8
    assert lines == [f"the two best starts differ: calibrating from {count}" for count in (4, 8)]
    asked.clear()
    diagnose(calibration.subject, "NGA", paths, starts=1)
    assert asked == [1]


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [*(id for id in HIDDEN_EFFECTS if id not in EXCLUDED_EFFECTS), None])
def test_an_effect_hidden_in_a_virtual_person_is_named(hidden, tmp_path):
    shown = demonstrate_diagnosis(tmp_path, hidden, seed=2)
    assert shown.correct, (shown.diagnosis.result.outcome, shown.diagnosis.result.named)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", EXCLUDED_EFFECTS)
def test_an_effect_too_weak_to_be_named_leads_the_list(hidden, tmp_path):
    shown = demonstrate_diagnosis(tmp_path, hidden, seed=2)
    result = shown.diagnosis.result
    assert max(result.effects, key=lambda effect: effect.probability).id == hidden
    assert shown.correct or not (result.named or result.ties)
