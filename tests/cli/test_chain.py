"""From markers to a calibrated model: joints, inverse dynamics, calibration, and an index of all results."""

import json

import pytest

from tests.preprocessing import walker
from wrapjax.report.overview import find_results
from wrapjax.subject.subject import load_subject


@pytest.fixture(scope="module")
def chain(run, tmp_path_factory):
    """Outcomes of the commands, and the folder of all results."""
    folder = tmp_path_factory.mktemp("chain")
    settings = walker.write_laboratory(folder / "lab")
    outcomes = [run("joints", settings, "--out", folder / "joints", "--quiet")]
    text = settings.read_text()
    model = next(line for line in text.splitlines() if line.startswith("file = "))
    done = folder / "joints"
    given = f'file = "{done / "model_joints.osim"}"\njoints = "{done / "joints.json"}"'
    settings.write_text(text.replace(model, given))
    outcomes.append(run("prepare", settings, "--out", folder / "subject", "--quiet"))
    outcomes.append(
        run("calibrate", folder / "subject", "--method", "NGA", "--out", folder / "NGA", "--starts", "1")
    )
    outcomes.append(run("report", folder))
    return outcomes, folder


@pytest.mark.slow
def test_every_step_takes_what_the_one_before_wrote(chain):
    outcomes, folder = chain
    assert [one.status for one in outcomes] == [0] * 4, [one.progress[-500:] for one in outcomes]
    content = json.loads((folder / "joints" / "joints.json").read_text())
    spread = load_subject(folder / "subject").joint_spread
    # The leg that is calibrated, with the uncertainty of its joints and between them.
    for joint in content["joints"].values():
        for name in joint["coordinates"]:
            if name.endswith("_l"):
                assert set(spread[name].correlation) >= set(joint["coordinates"])


@pytest.mark.slow
def test_one_index_links_all_results(chain):
    found = {one.kind: one for one in find_results(chain[1])}
    assert {"joint personalisation", "calibration"} <= set(found)
    page = (chain[1] / "index.html").read_text()
    for result in found.values():
        assert f"{result.folder.name}/report.html" in page
