"""OpenSim reads all tables, models and external loads that commands write, with the same numbers.

One folder of each kind is tested. PGA's model needs a calibration of its own, and is tested in
``tests/path_sources/test_exact.py``.
"""

import shutil
import xml.etree.ElementTree as ElementTree

import numpy as np
import opensim
import pytest

from tests.cli.folders import METHOD
from tests.cli.test_diagnose import QUICK
from tests.contact_forces.synthetic_run import write_run
from tests.preprocessing import walker
from tests.subject.synthetic import write_subject
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject
from wrapjax.io.storage import read_storage
from wrapjax.subject.subject import load_subject

TABLES = (".sto", ".mot")


@pytest.fixture(scope="module")
def with_uncertainty(run, subject, fitted, tmp_path_factory):
    """Folder of a calibration with bands about its moments."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    words = ("--uncertainty", "laplace", "--starts", "1", "--fit", fitted[1], "--out", folder)
    assert run("calibrate", subject, *METHOD, *words).status == 0
    return folder


def calibration(request, run, folder):
    shutil.copytree(request.getfixturevalue("with_uncertainty"), folder)
    return 0


def evaluation(request, run, folder):
    calibrated, subject = map(request.getfixturevalue, ("with_uncertainty", "subject"))
    return run("evaluate", calibrated, subject, "--out", folder).status


def contact(request, run, folder):
    """Folder of contact forces of a leg with an undriven muscle."""
    person = write_subject(folder.parent / "one_channel")
    settings = person / "subject.toml"
    settings.write_text(settings.read_text().replace('SemiTen = ["semiten_l"]\n', ""))
    loaded = load_subject(person)
    assert loaded.undriven_muscles == ("semiten_l",)
    finished = write_run(folder.parent / "run", loaded, muscles=("recfem_l",))
    return run("contact", finished, "--out", folder).status


def preparation(request, run, folder):
    """Prepared subject folder with one cycle."""
    laboratory = folder.parent / "laboratory"
    laboratory.mkdir()
    settings = walker.write_laboratory(laboratory)
    text = settings.read_text().replace('emg = "emg.sto"', 'emg = "emg.sto"\ncycles = [[1.566, 2.666]]')
    settings.write_text(text)
    return run("prepare", settings, "--out", folder).status


def diagnosis(request, run, folder):
    """Folder of a diagnosis with too few cycles for a result; moments are written nevertheless."""
    subject, fitted = map(request.getfixturevalue, ("subject", "fitted"))
    return run("diagnose", subject, "--fit", fitted[1], *QUICK, "--out", folder).status - 1


def virtual_person(request, run, folder):
    """Subject folder of a virtual person."""
    write_virtual_subject(folder, series=(Series(1.2, 1, 0),))
    return 0


CURVES = {"moments", "activations", "muscle_forces"}
#: For each kind of folder: function that writes it, folders of its tables, and its models and external loads.
KINDS = {
    "calibrate": (calibration, CURVES | {"moment_bands"}, set()),
    "evaluate": (evaluation, {"moments"}, set()),
    "contact": (contact, {"forces", "undriven_activations", "undriven_forces"}, set()),
    "prepare": (preparation, {"trials"}, {"model.osim", "external_loads.xml"}),
    "diagnose": (diagnosis, {"moments"}, set()),
    "demo": (virtual_person, {"trials"}, {"model.osim"}),
}


@pytest.fixture(scope="module", params=KINDS)
def written(request, run, tmp_path_factory):
    fill, tables, others = KINDS[request.param]
    folder = tmp_path_factory.mktemp("written") / "folder"
    assert fill(request, run, folder) == 0
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    found = {file.relative_to(folder).parts[0] for file in files if file.suffix in TABLES}
    assert found == tables, "every kind of table is named here"
    assert {file.name for file in files if file.suffix in (".osim", ".xml")} == others
    return files


def test_what_is_written_opens(written):
    for file in written:
        if file.suffix in TABLES:
            opens_as_a_table(file)
        elif file.suffix == ".osim":
            opens_as_a_model(file)
        elif file.suffix == ".xml":
            opens_as_external_loads(file)
        elif file.suffix == ".osimx":
            named = ElementTree.parse(file).getroot().findtext("OsimxModel/associated_osim_model")
            opens_as_a_model(file.parent / named)


def opens_as_a_table(file):
    table, own = opensim.TimeSeriesTable(str(file)), read_storage(file)
    assert len(own.time) > 1 and own.columns, file
    assert tuple(table.getColumnLabels()) == tuple(own.columns), file
    np.testing.assert_array_equal(table.getIndependentColumn(), own.time, str(file))
    np.testing.assert_array_equal(table.getMatrix().to_numpy(), own.values, str(file))
    # The class by which OpenSim's GUI reads tables.
    storage = opensim.Storage(str(file))
    assert (storage.getSize(), storage.isInDegrees()) == (len(own.time), own.in_degrees), file


def opens_as_a_model(file):
    model = opensim.Model(str(file))
    model.initSystem()
    assert model.getBodySet().getSize() > 0 and model.getMuscles().getSize() > 0, file


def opens_as_external_loads(file):
    loads = opensim.ExternalLoads(str(file), True)
    names = {loads.get(number).get_applied_to_body() for number in range(loads.getSize())}
    assert names == {"calcn_l", "calcn_r"}, file
    assert (file.parent / loads.getDataFileName()).suffix == ".mot"
