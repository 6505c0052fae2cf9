"""Comparison of methods in Python: subjects, refused input, paths of each method, and saved files."""

import inspect
import json
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

import wrapjax
from tests.calibration.test_two_legs import name_other_leg, write_right_leg
from tests.subject.synthetic import write_subject, write_wrapped_subject
from wrapjax.calibration.calibration import calibrate
from wrapjax.calibration.problem import METHODS
from wrapjax.comparison.comparison import compare
from wrapjax.errors import InputError
from wrapjax.path_sources.exact import ExactGeometry
from wrapjax.path_sources.polynomial_fit import Fit
from wrapjax.subject.subject import load_subject

#: Where a leg touches no wrapping surface, LSGA has nothing to free.
BOTH = ("NGA", "SGA")
WITHOUT_CYLINDERS = ("NGA", "SGA", "LSGA")


@pytest.fixture(scope="module")
def wrapped(tmp_path_factory):
    """Subject with one of two muscles wrapping round a cylinder."""
    return load_subject(write_wrapped_subject(tmp_path_factory.mktemp("subjects") / "wrapped"))


@pytest.fixture(scope="module")
def done(wrapped, tmp_path_factory):
    checkpoints = tmp_path_factory.mktemp("journals") / "journal"
    return compare([wrapped], WITHOUT_CYLINDERS, starts=1, checkpoints=checkpoints)


@pytest.fixture(scope="module")
def saved(done, tmp_path_factory):
    folder = tmp_path_factory.mktemp("comparisons") / "out"
    done.save(folder)
    return folder


@pytest.fixture
def no_work(monkeypatch):
    def started(*arguments, **options):
        raise AssertionError("it started to work")

    monkeypatch.setattr("wrapjax.comparison.comparison.calibrate", started)


def test_results_equal_those_of_calibrate(done, wrapped):
    alone = calibrate(wrapped, "NGA", starts=1)
    assert done.converged and done.methods == WITHOUT_CYLINDERS and done.labels == ("synthetic",)
    np.testing.assert_allclose(done.calibrations[0][0].result.modelled, alone.result.modelled, rtol=1e-9)
    (leg,) = done.legs
    assert list(leg.results) == list(WITHOUT_CYLINDERS) and leg.results["SGA"].method == "SGA"
    assert leg.results["LSGA"].freedom.paths.muscles.tolist() == [False, True]
    assert leg.model is None, "no cylinder moved: no model is opened"
    with pytest.raises(FrozenInstanceError):
        done.methods = ("PGA",)


def test_public_names():
    assert wrapjax.compare is compare and isinstance(wrapjax.Comparison, type)


def test_folder(saved, done):
    assert [path.name for path in saved.parent.iterdir()] == ["out"]
    files = {"comparison.json", "cycles.csv", "means.csv", "report.html", "tests.csv"}
    assert {path.name for path in saved.iterdir()} == files | {"synthetic"}
    content = json.loads((saved / "comparison.json").read_text(encoding="utf-8"))
    for leg in content["legs"]:
        for method, run in leg["runs"].items():
            summary = json.loads((saved / run["folder"] / "summary.json").read_text(encoding="utf-8"))
            assert (summary["method"], summary["cost"]) == (method, run["cost"])
            assert (run["seconds"], run["geometry"]) == (summary["seconds"], "surrogate")
            # The table of the comparison agrees with the summary of the run.
            (row,) = [
                row
                for row in content["quantities"]["moment_error"]
                if (row["use"], row["speed"], row["item"]) == ("calibration", "all speeds", "mean")
            ]
            assert row["methods"][method]["mean"] == pytest.approx(summary["mae_Nm"]["calibration"]["mean"])
            change = [
                next(row for row in content["quantities"][name] if row["item"] == "mean")["methods"][method]
                for name in ("length_change", "moment_arm_change")
            ]
            expected = summary["geometry_change"]
            assert change[0]["mean"] == pytest.approx(expected["length_mae_m"])
            assert change[1]["mean"] == pytest.approx(expected["moment_arm_mae_m"])
    assert not done.checkpoints.exists(), "the journal is thrown away once all is written"


def test_saving_again_is_refused(saved, done):
    before = (saved / "comparison.json").read_bytes()
    with pytest.raises(InputError, match="exists already"):
        done.save(saved)
    assert (saved / "comparison.json").read_bytes() == before


@pytest.mark.slow
def test_saving_again_by_force(done, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old.txt").touch()
    done.save(tmp_path / "out", force=True)
    assert (tmp_path / "out" / "synthetic" / "NGA" / "report.html").is_file()
    assert not (tmp_path / "out" / "old.txt").exists()


def test_interrupted_and_resumed(wrapped, done, tmp_path):
    checkpoints = tmp_path / "journal"
    lengths = [len(one.result.solution.history) for one in done.calibrations[0]]
    calls = []

    def stop(start, iteration, state):
        calls.append(iteration.number)
        if len(calls) > lengths[0] + 2:
            raise KeyboardInterrupt

    def again(methods, **options):
        return compare([wrapped], methods, starts=1, checkpoints=checkpoints, **options)

    with pytest.raises(KeyboardInterrupt):
        again(WITHOUT_CYLINDERS, callback=stop)
    first = len(calls)
    with pytest.raises(InputError, match="other data or settings"):
        again(WITHOUT_CYLINDERS, curves="opensim", resume=True)
    resumed = again(WITHOUT_CYLINDERS, resume=True, callback=lambda *_: calls.append(None))
    for ours, theirs in zip(resumed.calibrations[0], done.calibrations[0], strict=True):
        assert ours.result.solution.cost == pytest.approx(theirs.result.solution.cost, rel=1e-10)
    # Finished calibrations are not repeated.
    assert len(calls) - first < sum(lengths) - lengths[0] + 2


class TestRefused:
    """Errors before any calibration."""

    def test_method_that_frees_nothing(self, person, no_work):
        with pytest.raises(InputError, match="LSGA frees nothing"):
            compare([person])

    @pytest.mark.parametrize(
        ("methods", "words"),
        [
            (("NGA", "SGAA"), "'SGAA' is not known; did you mean 'SGA'"),
            (("NGA",), "expected two or more, each once, found NGA"),
            (("NGA", "NGA"), "expected two or more, each once, found NGA, NGA"),
            ((), "found none"),
        ],
    )
    def test_methods(self, person, no_work, methods, words):
        with pytest.raises(InputError, match=words):
            compare([person], methods)

    def test_no_subject(self, no_work):
        with pytest.raises(InputError, match="expected at least one"):
            compare([], BOTH)

    def test_geometry(self, person, no_work):
        with pytest.raises(ValueError, match="unknown geometry 'opensim': expected one of surrogate, engine"):
            compare([person], BOTH, geometry="opensim")

    def test_two_legs_by_the_engine(self, no_work, tmp_path):
        """The other leg's paths are polynomials: one leg by each would be no fair comparison."""
        left = write_subject(tmp_path / "left")
        write_right_leg(tmp_path / "right")
        name_other_leg(left, "../right")
        with pytest.raises(InputError, match="calibrated together through polynomials only"):
            compare([load_subject(left)], BOTH, geometry="engine")

    def test_same_name_and_side(self, person, no_work, tmp_path):
        other = load_subject(write_subject(tmp_path / "other"))
        with pytest.raises(InputError, match=r"has the name of .*'synthetic', and the same side"):
            compare([person, other], BOTH)

    def test_nothing_to_resume(self, person, no_work, tmp_path):
        with pytest.raises(InputError, match="no interrupted work"):
            compare([person], BOTH, checkpoints=tmp_path / "journal", resume=True)


class TestNames:
    """Names of folders for arbitrary names of subjects."""

    @pytest.fixture
    def calls(self, monkeypatch, calibrated):
        found = []

        def note(subject, method, fit, **options):
            found.append((subject.name, subject.side, method))
            return replace(calibrated, subject=subject)

        monkeypatch.setattr("wrapjax.comparison.comparison.calibrate", note)
        return found

    @pytest.mark.parametrize(
        ("name", "label"), [("../../Zoë M.", "_.._Zoë_M"), ("..", "subject"), ("a/b", "a_b")]
    )
    def test_stay_within_the_folder(self, person, calls, name, label):
        assert compare([replace(person, name=name)], BOTH).labels == (label,)

    def test_sides_distinguish_the_same_names(self, person, calls, tmp_path):
        right = load_subject(write_right_leg(tmp_path / "right"))
        assert compare([person, right], BOTH).labels == ("synthetic_left", "synthetic_right")

    def test_a_subject_given_twice_is_calibrated_once(self, person, calls):
        assert compare([person, person], BOTH).labels == ("synthetic",)
        assert calls == [("synthetic", "l", method) for method in BOTH]

    @pytest.mark.parametrize("both_point", [True, False])
    def test_legs_calibrated_together_are_calibrated_once(self, calls, tmp_path, both_point):
        left, right = write_subject(tmp_path / "left"), write_right_leg(tmp_path / "right")
        name_other_leg(left, "../right")
        if both_point:
            name_other_leg(right, "../left")
        # In either order.
        compare([load_subject(right), load_subject(left)], BOTH)
        assert {side for _, side, _ in calls} == ({"r"} if both_point else {"l"})
        assert len(calls) == 2


@pytest.fixture
def received_paths(calibrated, monkeypatch):
    """Record the muscle paths that each method receives; nothing is calibrated."""
    given = {}

    def note(subject, method, fit, **options):
        given[method] = fit
        return replace(calibrated, fit=fit)

    monkeypatch.setattr("wrapjax.comparison.comparison.calibrate", note)
    return given


def test_paths_of_each_method(wrapped, received_paths):
    """With the engine, NGA and PGA have exact paths; SGA and LSGA change polynomials and must have these."""
    compared = compare([wrapped], METHODS, geometry="engine")
    assert {method: type(fit) for method, fit in received_paths.items()} == {
        "NGA": ExactGeometry,
        "SGA": Fit,
        "LSGA": Fit,
        "PGA": ExactGeometry,
    }
    assert received_paths["NGA"] is received_paths["PGA"] and received_paths["SGA"] is received_paths["LSGA"]
    assert received_paths["SGA"].geometry == "engine", "all start from one geometry"
    assert compared.legs[0].geometry == {
        "NGA": "engine",
        "SGA": "surrogate",
        "LSGA": "surrogate",
        "PGA": "engine",
    }
    compare([wrapped], WITHOUT_CYLINDERS)
    assert {received_paths[method].geometry for method in WITHOUT_CYLINDERS} == {"opensim"}


def test_all_methods_use_the_polynomials_of_pga(wrapped, received_paths, monkeypatch):
    """Otherwise differences between methods would include those between OpenSim's paths and the engine's."""
    problem = "wrapjax.calibration.problem"
    monkeypatch.setattr(f"{problem}.fit_wraps", lambda subject, fit, **_: replace(fit, key="sampled"))
    monkeypatch.setattr("wrapjax.comparison.comparison.method_freedom", lambda *_: None)
    compare([wrapped], METHODS)
    assert {id(fit) for fit in received_paths.values()} == {id(received_paths["PGA"])}
    assert (received_paths["NGA"].key, received_paths["NGA"].geometry) == ("sampled", "engine")


@pytest.mark.slow
def test_all_four_methods_by_the_engine(wrapped, tmp_path):
    compared = compare([wrapped], geometry="engine", starts=1)
    compared.save(tmp_path / "out")
    costs = {
        method: one.result.solution.cost
        for method, one in zip(METHODS, compared.calibrations[0], strict=True)
    }
    assert compared.converged and costs["PGA"] < costs["NGA"]
    for page in (tmp_path / "out" / "synthetic" / "PGA" / "report.html", tmp_path / "out" / "report.html"):
        assert "ST_at_condyles_l: moved" in page.read_text(encoding="utf-8")
    content = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    (row,) = [one for one in content["quantities"]["length_change"] if one["item"] == "mean"]
    pairs = {(test["method"], test["against"]) for test in row["paired_t"]}
    assert pairs == {("LSGA", "SGA"), ("PGA", "SGA"), ("PGA", "LSGA")}


def test_both_legs_are_compared(calibrated, person):
    """The other leg has a label and a folder of its own, even with the same name."""
    other = replace(calibrated, subject=replace(person, side="r"))
    both = replace(calibrated, other_leg=other)
    shown = wrapjax.Comparison(BOTH, ((both, both),), ("synthetic",))
    assert [leg.label for leg in shown.legs] == ["synthetic", "synthetic (other leg)"]
    assert shown.legs[1].folders["SGA"] == "synthetic/SGA/other_leg"
    named = replace(calibrated, other_leg=replace(other, subject=replace(person, name="right", side="r")))
    shown = wrapjax.Comparison(BOTH, ((named, named),), ("synthetic",))
    assert [leg.label for leg in shown.legs] == ["synthetic", "right"]


def test_all_methods_are_compared_by_default():
    """Including methods that are added later."""
    assert inspect.signature(compare).parameters["methods"].default is METHODS
