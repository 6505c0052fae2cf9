"""Calibration with a published muscle law: run folder, prediction, and laws that do not exist."""

import json

import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from wrapjax.calibration.calibration import calibrate
from wrapjax.cli.command_line import main
from wrapjax.evaluation.evaluation import evaluate
from wrapjax.evaluation.stored_run import load_run
from wrapjax.muscle.published_laws import PUBLISHED_LAWS, nearest_law
from wrapjax.path_sources.exact import exact_geometry


@pytest.fixture(scope="module")
def thelen(person):
    return calibrate(person, "NGA", exact_geometry(person), muscle_law="thelen", starts=1)


@pytest.fixture(scope="module")
def run(thelen, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    thelen.save(folder)
    return folder


def test_all_muscles_have_the_law(thelen):
    assert thelen.status.converged
    law = np.asarray(thelen.result.parameters.law)
    np.testing.assert_array_equal(law, np.broadcast_to(nearest_law("thelen"), law.shape))


def test_a_loaded_run_has_its_law(thelen, run, person):
    assert json.loads((run / "settings.json").read_text())["muscle_law"] == "thelen"
    assert_reproduces_itself(run, person)
    np.testing.assert_allclose(evaluate(run, person).modelled, thelen.result.modelled, atol=1e-9)


def test_moments_differ_from_those_of_another_law(thelen, run, person):
    """With the same parameters; otherwise the other tests would show nothing."""
    text = (run / "settings.json").read_text()
    try:
        (run / "settings.json").write_text(text.replace('"thelen"', '"nmsm"'))
        given = evaluate(load_run(run), person).modelled
    finally:
        (run / "settings.json").write_text(text)
    assert np.abs(given - thelen.result.modelled).max() > 0.1


def test_an_unknown_law_is_refused(person):
    with pytest.raises(ValueError, match="unknown muscle law 'millard': expected one of nmsm, "):
        calibrate(person, "NGA", exact_geometry(person), muscle_law="millard", starts=1)


def test_the_command_offers_the_published_laws(capsys):
    """They are written out there, so that help needs no JAX."""
    with pytest.raises(SystemExit) as stopped:
        main(["calibrate", "subject", "--out", "run", "--muscle-law", "millard"])
    assert stopped.value.code == 2
    message = capsys.readouterr().err
    offered = message[message.index("choose from") :]
    assert [law for law in PUBLISHED_LAWS if law not in offered] == []
    assert offered.count(",") == len(PUBLISHED_LAWS) - 1
