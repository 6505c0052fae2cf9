"""Whatever table a command writes, OpenSim reads: the same columns, rows and numbers."""

import numpy as np
import opensim
import pytest

from wrapjax.subject import read_storage


@pytest.fixture(scope="module")
def written(run, calibrated, subject, tmp_path_factory):
    """Folders of a calibration and of an evaluation."""
    evaluated = tmp_path_factory.mktemp("evaluated") / "out"
    assert run("evaluate", calibrated[1], subject, "--out", evaluated).status == 0
    return calibrated[1], evaluated


def test_tables(written):
    files = [file for folder in written for file in sorted(folder.rglob("*.sto"))]
    assert {file.parent.name for file in files} == {"moments", "activations", "muscle_forces"}
    for file in files:
        table, own = opensim.TimeSeriesTable(str(file)), read_storage(file)
        assert tuple(table.getColumnLabels()) == tuple(own.columns), file
        np.testing.assert_array_equal(table.getIndependentColumn(), own.time)
        np.testing.assert_array_equal(table.getMatrix().to_numpy(), own.values)
        assert opensim.Storage(str(file)).getSize() == len(own.time), "what its GUI reads it with"
