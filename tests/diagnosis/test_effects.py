"""Effects are off at zero to the last bit, have correct derivatives, and alter the model as defined."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial

from tests.diagnosis.subject import CURVES, EXCHANGED, small_recording_and_context
from wrapjax.diagnosis.effects.catalogue import CATALOGUE, available_effects, catalogue
from wrapjax.diagnosis.effects.effect import FAMILIES, Effect, Effects, NotTestable, Variant
from wrapjax.diagnosis.effects.measured_motion import neighboring_coordinates
from wrapjax.diagnosis.fits.prediction import finite_difference_signatures, predicted_moments, signatures
from wrapjax.errors import InputError
from wrapjax.geometry.paths import fixed_path
from wrapjax.model.forward import Recording, joint_moments

RECORDING, CONTEXT = small_recording_and_context(EXCHANGED)
ENTRIES = {entry.id: entry for entry in catalogue(CONTEXT)}
EFFECTS = available_effects(tuple(ENTRIES.values()))
ROUNDS = max(len(effect.variants) for effect in EFFECTS)
UNITS = {"1", "s", "m", "rad", "N m", "N m/deg", "N m/rad", "N m s/rad", "N m s"}


def all_at_once(number: int) -> Effects:
    """Combine all effects, each in its variant of this number; without labels, for one program."""
    unlabelled = [
        eqx.tree_at(
            lambda one: one.variants,
            effect,
            (Variant(effect.variants[number % len(effect.variants)].alteration),),
        )
        for effect in EFFECTS
    ]
    return Effects(tuple(unlabelled))


def predict(effects: Effects, effect_sizes) -> np.ndarray:
    return np.asarray(
        predicted_moments(CURVES, CONTEXT.parameters, RECORDING, effects, jnp.asarray(effect_sizes))
    )


def places_of(id: str) -> np.ndarray:
    labels = all_at_once(0).labels
    return np.array([number for number, label in enumerate(labels) if label.split(".")[0] == id])


@pytest.fixture(scope="module")
def plain():
    return np.asarray(joint_moments(CURVES, CONTEXT.parameters, RECORDING))


def slopes_at(effects: Effects, effect_sizes) -> np.ndarray:
    return np.asarray(signatures(CURVES, CONTEXT.parameters, RECORDING, effects, jnp.asarray(effect_sizes)))


@pytest.fixture(scope="module")
def slopes():
    """Signatures of all parameters, in every round of variants."""
    return [slopes_at(effects, effects.zero) for effects in map(all_at_once, range(ROUNDS))]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.id)
def test_zero_is_the_plain_model_to_the_last_bit(effect, plain):
    """Without compilation: two compiled programs may fuse, and so round, differently."""
    for number in range(len(effect.variants)):
        one = Effects((effect,), (number,))
        found = joint_moments(CURVES, CONTEXT.parameters, RECORDING, one.alterations(one.zero))
        np.testing.assert_array_equal(found, plain)


@pytest.mark.parametrize(
    "effect",
    [
        # Equilibria of tendons take long to compile; `tests/muscle` has their derivatives.
        pytest.param(effect, marks=[pytest.mark.slow] if effect.id == "tendon_compliance" else [])
        for effect in EFFECTS
    ],
    ids=lambda effect: effect.id,
)
def test_derivatives_agree_with_finite_differences(effect, slopes):
    """One direction through all parameters of an effect, with every other effect at zero."""
    places = places_of(effect.id)
    for number in range(len(effect.variants)):
        effects = all_at_once(number)
        size = np.random.default_rng(number).uniform(0.5, 1.0, len(places)) * effects.prior_sd[places]
        direction = np.zeros(effects.count)
        direction[places] = size
        step = 1e-4
        difference = (predict(effects, step * direction) - predict(effects, -step * direction)) / (2 * step)
        slope = np.tensordot(direction, slopes[number], axes=1)
        scale = np.abs(slope).max()
        assert scale > 1e-4
        np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-5 * scale)


def test_finite_difference_signatures_are_changes_at_the_prior_standard_deviation():
    effects = all_at_once(0)
    found = np.asarray(finite_difference_signatures(CURVES, CONTEXT.parameters, RECORDING, effects))
    for place, (size, parameter) in enumerate(zip(effects.prior_sd, effects.parameters, strict=True)):
        effect_sizes = np.zeros(effects.count)
        effect_sizes[place] = size
        other = -effect_sizes if parameter.sign == 0 else 0.0 * effect_sizes
        expected = predict(effects, effect_sizes) - predict(effects, other)
        span = size if parameter.sign else 2.0 * size
        scale = np.abs(expected).max()
        np.testing.assert_allclose(span * found[place], expected, rtol=0, atol=1e-9 * scale + 1e-9)


def test_prior_standard_deviations_are_scaled_within_the_limits():
    for effect in EFFECTS:
        larger = effect.of_size(3.0)
        assert larger.id == effect.id and larger.parts == effect.parts
        for before, after in zip(effect.parameters, larger.parameters, strict=True):
            assert after.prior_sd == min(3.0 * before.prior_sd, 0.5 * before.limit)
            assert (after.name, after.limit) == (before.name, before.limit)


def test_no_effects_at_all_are_the_plain_model(plain):
    np.testing.assert_allclose(predict(Effects(()), np.zeros(0)), plain, rtol=1e-13, atol=1e-12)


def test_derivatives_agree_with_finite_differences_with_all_effects_present():
    effects = all_at_once(0)
    effect_sizes = 0.3 * effects.prior_sd
    direction = effects.prior_sd * np.random.default_rng(7).normal(size=effects.count)
    slope = np.tensordot(direction, slopes_at(effects, effect_sizes), axes=1)
    ends = [predict(effects, effect_sizes + sign * 1e-5 * direction) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-5, rtol=0, atol=1e-5 * np.abs(slope).max())


def test_every_parameter_changes_the_moments(slopes):
    labels = all_at_once(0).labels
    largest = np.max([np.abs(one).max(axis=(1, 2, 3)) for one in slopes], axis=0)
    assert [label for label, size in zip(labels, largest, strict=True) if not size > 0.0] == []


def test_moments_are_finite_with_all_effects_large():
    """At three prior standard deviations, or the limit, and at negative sizes."""
    for number in range(ROUNDS):
        effects = all_at_once(number)
        for end in (
            np.minimum(effects.upper, 3 * effects.prior_sd),
            np.maximum(effects.lower, -effects.prior_sd),
        ):
            assert np.isfinite(predict(effects, end)).all()


def test_effects_interact():
    """Slower fibers behind a compliant tendon differ from the sum of both effects."""
    effects = all_at_once(0)

    def changed(*ids: str):
        effect_sizes = np.zeros(effects.count)
        for id in ids:
            effect_sizes[places_of(id)] = effects.prior_sd[places_of(id)]
        return predict(effects, effect_sizes) - predict(effects, np.zeros(effects.count))

    both, one, other = (
        changed("tendon_compliance", "slow_fibers"),
        changed("tendon_compliance"),
        changed("slow_fibers"),
    )
    assert np.abs(both - one - other).max() > 0.01 * np.abs(both).max()
    # What is added to the moments does not interact with muscles.
    together = changed("slow_fibers", "ankle_foot_orthosis")
    np.testing.assert_allclose(together, other + changed("ankle_foot_orthosis"), atol=1e-9)


def test_selected_cycles_are_predicted_as_among_all():
    """An effect size must mean the same for a held-out cycle as for the others."""
    keep = np.array([3, 2])
    # The other effects do not depend on the cycle.
    ids = (
        "missing_drive",
        "spasticity_unrecorded",
        "spasticity_recorded",
        "speed_dependent_delay",
        "emg_drift",
    )
    ids += ("posture_dependent_gain", "soft_tissue_artifact", "event_jitter", "wrap_surface", "cop_offset")
    ids += ("passive_joint_moment", "biarticular_spring", "joint_damping", "ankle_foot_orthosis")
    emg, path = jax.tree.map(lambda leaf: leaf[:, keep], (RECORDING.emg, RECORDING.path.nominal))
    some = CONTEXT.select([3, 2, 1]).select([0, 1])
    few, whole = Effects(tuple(CATALOGUE[id].build(some) for id in CATALOGUE if id in ids)), all_at_once(0)
    effect_sizes = np.zeros(whole.count)
    effect_sizes[[whole.labels.index(label) for label in few.labels]] = 0.5 * few.prior_sd
    recording = Recording(emg, fixed_path(path), RECORDING.padding)
    own = jnp.asarray(0.5 * few.prior_sd)
    found = predicted_moments(CURVES, CONTEXT.parameters, recording, few, own)
    np.testing.assert_allclose(found, predict(whole, effect_sizes)[keep], rtol=1e-10, atol=1e-9)


# ---- Definitions


def test_the_catalogue_is_complete():
    assert list(ENTRIES) == list(CATALOGUE) and len(CATALOGUE) == 44
    controls = {id for id, entry in ENTRIES.items() if isinstance(entry, Effect) and entry.negative_control}
    assert controls == {"short_range_stiffness", "spasticity_recorded"}
    meanings = [entry.meaning for entry in CATALOGUE.values()]
    assert len(set(meanings)) == len(meanings)
    for clause in meanings:
        assert len(clause.split()) > 3 and not clause.endswith("."), clause
    nuisances = {entry.id for entry in CATALOGUE.values() if entry.nuisance}
    assert nuisances == {"curve_family", "emg_smoothing", "activation_family", "joint_center_spread"}


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.id)
def test_parameters_are_documented(effect):
    assert effect.family in FAMILIES
    labels = [variant.label for variant in effect.variants]
    assert len(set(labels)) == len(labels)
    for entry in effect.parameters:
        assert entry.unit in UNITS and entry.meaning and entry.source
        assert entry.lower == (0.0 if entry.sign else -entry.upper) and entry.prior_sd < entry.upper


def test_reported_quantities_have_names_and_physical_values():
    def reported_values(id: str, *effect_sizes: float) -> dict[str, float]:
        return {
            name: float(value) for name, value in ENTRIES[id].reported_values(jnp.array(effect_sizes)).items()
        }

    assert reported_values("tendon_compliance", 0.05) == {"strain_at_max_force": 0.05}
    assert reported_values("slow_fibers", 0.0) == {"max_velocity_factor": 1.0}
    assert reported_values("slow_fibers", np.log(2.0)) == pytest.approx({"max_velocity_factor": 0.5})
    assert reported_values("activation_dependent_fiber_length", 0.1) == {"length_gain": 0.1}
    assert reported_values("ankle_foot_orthosis", 1.0, 0.5, 0.0)["dorsiflexion_stiffness"] == 1.0
    assert reported_values("speed_dependent_delay", 0.01) == {"delay_slow_minus_fast": 0.01}
    assert reported_values("emg_drift", *[0.1] * 5)["gain_change_TibAnt"] == 0.1
    # Splines of one height add up to that height.
    assert reported_values("missing_drive", *[0.4] * 10) == pytest.approx({"peak_activation": 0.4})
    assert set(reported_values("cop_offset", 0.01, 0.0)) == {"anterior_m", "lateral_m"}


def change(id: str, *effect_sizes: float, number: int = 0) -> np.ndarray:
    """Compute the change of the moments by one effect, by trial, coordinate and frame."""
    effects = all_at_once(number)
    vector = np.zeros(effects.count)
    vector[places_of(id)] = effect_sizes
    return predict(effects, vector) - predict(effects, np.zeros(effects.count))


def test_passive_effects_oppose_motion():
    """Damping removes energy; passive moments and an orthosis oppose the angle."""
    for coordinate, entry in enumerate(ENTRIES["joint_damping"].parameters):
        effect_sizes = np.zeros(3)
        effect_sizes[coordinate] = entry.prior_sd
        power = change("joint_damping", *effect_sizes) * CONTEXT.velocities
        assert (power <= 1e-12).all() and power[:, coordinate].min() < -0.1
    ankle = np.rad2deg(CONTEXT.angles[:, 2])
    orthosis = change("ankle_foot_orthosis", 2.0, 0.0, 0.0, number=1)[:, 2]
    np.testing.assert_allclose(orthosis, -2.0 * np.maximum(ankle, 0.0), atol=1e-9)
    for number in range(3):
        for coordinate in range(3):
            effect_sizes = np.zeros(6)
            effect_sizes[2 * coordinate] = 5.0
            upper = change("passive_joint_moment", *effect_sizes, number=number)[:, coordinate]
            assert upper.max() <= 1e-9 and upper.min() == pytest.approx(-5.0)


def test_delay_is_longer_when_slow():
    """A lag of one frame shifts moments by about a frame; fast cycles come earlier instead."""
    effect_sizes = np.zeros(all_at_once(0).count)
    effect_sizes[places_of("speed_dependent_delay")] = 0.02
    moved = Effects((ENTRIES["speed_dependent_delay"],)).alterations(jnp.array([0.02]))[0]
    np.testing.assert_allclose(moved.emg(RECORDING.emg).lag[0], [0.01, 0.01, -0.01, -0.01], atol=1e-15)


def test_drift_has_no_mean_and_runs_from_first_to_last():
    effect = ENTRIES["emg_drift"]
    altered = effect.alteration(jnp.array([0.3, 0.0, 0.0, 0.0, 0.0])).emg(RECORDING.emg)
    recorded = np.asarray(RECORDING.emg.coefficients / altered.coefficients)[0, :, 3, 0]
    assert recorded.mean() == pytest.approx(1.0) and recorded[-1] / recorded[0] == pytest.approx(1.3)


def test_crosstalk_takes_a_share_of_the_neighbour_from_all_muscles_of_a_channel():
    effect = ENTRIES["emg_crosstalk"]
    names = [entry.name for entry in effect.parameters]
    effect_sizes = np.zeros(len(names))
    effect_sizes[names.index("Sol_in_Gas")] = 0.2
    altered = np.asarray(effect.alteration(jnp.asarray(effect_sizes)).emg(RECORDING.emg).coefficients)
    emg = np.asarray(RECORDING.emg.coefficients)
    for head in (1, 2):
        np.testing.assert_allclose(altered[head], emg[head] - 0.2 * emg[0], atol=1e-15)
    np.testing.assert_array_equal(altered[[0, 3, 4, 5]], emg[[0, 3, 4, 5]])
    assert "SemiMemb_in_TibAnt" not in names


def test_transmitted_force_acts_along_both_paths():
    """Soleus has no moment arm about the knee: force that gastrocnemius transmits to it has none either."""
    along_soleus = change("force_sharing", 0.0, 0.1)
    assert np.abs(along_soleus[:, 1]).max() < 1e-9 and along_soleus[:, 2].min() < -0.5
    along_gastrocnemius = change("force_sharing", 0.1, 0.0)
    assert along_gastrocnemius[:, 1].max() > 0.5


def test_short_range_stiffness_changes_nothing_in_gait(slopes):
    """At ten prior standard deviations, since muscles are never held at constant length."""
    effects = all_at_once(0)
    place = places_of("short_range_stiffness")
    moved = np.abs(10 * effects.prior_sd[place] * slopes[0][place]).max()
    assert moved < 0.1


# ---- Requirements


@pytest.mark.parametrize(
    ("changed", "id", "word"),
    [
        ({"paretic": False}, "contracture", "paretic"),
        ({"paretic": False}, "spasticity_unrecorded", "paretic"),
        ({"undriven_muscles": None}, "missing_drive", "every muscle"),
        ({"undriven_muscles": None}, "spasticity_unrecorded", "every muscle"),
        ({"speeds": np.full(4, np.nan)}, "speed_dependent_delay", "not given"),
        ({"speeds": np.full(4, 0.8)}, "speed_dependent_delay", "one speed"),
        ({"order": np.zeros(4)}, "emg_drift", "one cycle"),
        ({}, "emg_channel_loss", "next to nothing"),
        ({"muscle_channels": (0,) * 6}, "emg_channel_swap", "usual phases"),
        ({"paths_by_angle": None}, "soft_tissue_artifact", "joint angles"),
        ({"wraps": None}, "wrap_surface", "surfaces"),
        ({"attachments": None}, "muscle_attachment", "ends"),
        ({"at_bounds": ()}, "bound_pressure", "at a bound"),
        ({"measured_changes": {}}, "cop_offset", "ground reaction forces"),
        ({}, "handrail_force", "handrail"),
        ({"coordinates": ("hip_flexion_l", "knee_angle_l", "toes_l")}, "ankle_foot_orthosis", "ankle"),
        ({"coordinates": ("hip_flexion_l", "b_l", "ankle_angle_l")}, "biarticular_spring", "knee"),
    ],
)
def test_unmet_requirements_give_the_reason(changed, id, word):
    found = CATALOGUE[id].build(dataclasses.replace(CONTEXT, **changed))
    assert isinstance(found, NotTestable) and found.id == id
    assert word in found.reason


def test_soft_tissue_artifact_changes_measured_moments_where_these_are_known():
    """Each variant by its own change."""
    effect_sizes = jnp.arange(1.0, 1.0 + 3 * len(CONTEXT.coordinates))
    pattern = jnp.ones((len(CONTEXT.trials), len(CONTEXT.coordinates), CONTEXT.angles.shape[-1]))
    known = {"soft_tissue_artifact": {"loading": Partial(_summed, pattern)}}
    effect = CATALOGUE["soft_tissue_artifact"].build(dataclasses.replace(CONTEXT, measured_changes=known))
    loading, swing = (variant.alteration(effect_sizes) for variant in effect.variants)
    np.testing.assert_allclose(loading.moment, effect_sizes.sum() * pattern)
    assert swing.moment is None and swing.paths is not None


def test_skin_moves_with_the_neighboring_joint():
    """The knee's with the hip, all others with the knee; no such parameters where either is missing."""
    names = [entry.name for entry in ENTRIES["soft_tissue_artifact"].parameters]
    assert names[-3:] == [
        "share_of_knee_angle_l_in_hip_flexion_l",
        "share_of_hip_flexion_l_in_knee_angle_l",
        "share_of_knee_angle_l_in_ankle_angle_l",
    ]
    assert neighboring_coordinates(("hip_flexion_r", "ankle_angle_r")) == ()
    alone = dataclasses.replace(CONTEXT, coordinates=("toes_l", *CONTEXT.coordinates[1:]))
    assert len(CATALOGUE["soft_tissue_artifact"].build(alone).parameters) == 2 * len(CONTEXT.coordinates)


def test_measurement_effects_change_paths_where_these_are_known():
    """Moments by the measured change and paths by their derivatives; otherwise moments alone."""
    effect_sizes = jnp.array([0.05])
    effect = CATALOGUE["foot_deformation"].build(CONTEXT)
    assert [variant.label for variant in effect.variants] == ["whole foot", "forefoot"]
    whole, forefoot = (variant.alteration(effect_sizes) for variant in effect.variants)
    assert whole.paths is None and whole.moment is not None
    np.testing.assert_array_equal(
        forefoot.moment, CONTEXT.measured_changes["foot_deformation"]["forefoot"](effect_sizes)
    )
    paths, slopes = forefoot.paths(CONTEXT.paths), CONTEXT.path_changes["foot_deformation"]["forefoot"]
    for field in ("length", "velocity", "moment_arm"):
        expected = getattr(CONTEXT.paths, field) + 0.05 * getattr(slopes, field)[:, 0]
        np.testing.assert_allclose(getattr(paths, field), expected)


def _summed(pattern, effect_sizes):
    return effect_sizes.sum() * pattern


def test_effects_can_be_left_out_and_unknown_ones_are_refused():
    left = catalogue(CONTEXT, without=("tendon_compliance", "emg_drift"))
    assert len(left) == len(CATALOGUE) - 2 and not {"tendon_compliance", "emg_drift"} & {e.id for e in left}
    with pytest.raises(InputError, match=r"no effect 'tendon_complience'.*tendon_compliance"):
        catalogue(CONTEXT, without=("tendon_complience",))
