"""Labelled results: every number is where its labels say, and every variable has a unit."""

import numpy as np

from wrapjax.model import QUANTITIES


def test_a_calibration_is_labelled(calibrated):
    result, dataset = calibrated.result, calibrated.dataset
    assert all("units" in dataset[name].attrs and dataset[name].attrs["long_name"] for name in dataset)
    at = {"trial": "walk_b", "muscle": "semiten_l"}
    row, trial = result.muscles.index("semiten_l"), result.trials.index("walk_b")
    np.testing.assert_array_equal(dataset["activation"].sel(at), result.states.activation[row, trial])
    np.testing.assert_array_equal(
        dataset["moment_arm"].sel(at | {"coordinate": "knee_angle_l"}),
        result.states.path.moment_arm[row, trial, result.coordinates.index("knee_angle_l")],
    )
    for name in QUANTITIES:
        assert float(dataset[name].sel(muscle="semiten_l")) == float(getattr(result.parameters, name)[row])
    # What the muscles do adds up to the moments, by the labels alone.
    total = (dataset["tendon_force"] * dataset["moment_arm"]).sum("muscle")
    np.testing.assert_allclose(
        total.transpose("trial", "coordinate", "frame"), dataset["modelled_moment"], atol=1e-9
    )
    assert dataset.sel(trial="walk_b")["use"].item() == "validation" and dataset.attrs["method"] == "NGA"
