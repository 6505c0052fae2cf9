"""Table of contact force peaks in bodyweights and their phases."""

import numpy as np
import pytest

from tests.contact_forces.synthetic_run import write_run
from tests.subject.synthetic_forces import with_forces
from validation.calibration.contact_forces import peak_table
from wrapjax.contact_forces.contact_force import contact


def test_table_has_the_peaks_of_the_curves(tmp_path):
    subject = with_forces(tmp_path / "person")
    runs = [
        write_run(tmp_path / method, subject, method, factor=size)
        for method, size in (("NGA", 1), ("PGA", 1.2))
    ]
    result = contact(*runs, condyle_distance=0.04).result
    header, _, *lines = peak_table(result)
    assert header == "| | NGA | at | PGA | at |"
    cells = {line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[2:-1]] for line in lines}
    assert list(cells) == [
        *("hip, peak", "hip, first peak", "knee, peak", "medial knee, peak", "lateral knee, peak")
    ]
    for column, run in ((0, result.runs[0]), (2, result.runs[1])):
        knee = run.magnitude[:, 1] / result.bodyweight
        assert float(cells["knee, peak"][column]) == pytest.approx(knee.max(axis=1).mean(), abs=0.005)
        phase = result.phase[np.arange(3), knee.argmax(axis=1)] % 100.0
        assert cells["knee, peak"][column + 1] == f"{phase.mean():.0f} %"
