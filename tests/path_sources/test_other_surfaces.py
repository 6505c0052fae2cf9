"""PGA with surfaces other than cylinders: freedom, calibration and the personalised model in OpenSim."""

import jax
import numpy as np
import pytest

from tests.path_sources.round_trip import assert_reproduces_itself
from tests.subject.synthetic import MODEL, write_subject
from wrapjax.cli.command_line import main
from wrapjax.evaluation.stored_run import load_run
from wrapjax.geometry.exact_paths.engine import PARITY, ExactPaths, wrap_at_samples
from wrapjax.geometry.exact_paths.wrapping import (
    NOMINAL_PARAMETERS,
    PARAMETERS,
    PARAMETERS_OF,
    parameter_names,
)
from wrapjax.geometry.surrogates.wrap_bounds import MAX_ROTATION, SHAPE_FACTORS, parameter_box
from wrapjax.model.freedom import nga_freedom, with_wraps
from wrapjax.model.variables import free_variables
from wrapjax.osim.model import describe_model
from wrapjax.osim.muscle_analysis import analyse_muscles
from wrapjax.path_sources.exact import freed_wraps
from wrapjax.path_sources.model_inputs import model_parameters
from wrapjax.subject.subject import load_subject

SPHERE = """<WrapSphere name="kneecap"><active>true</active><xyz_body_rotation>0 0 0</xyz_body_rotation>
 <translation>0.02 -0.4 0.005</translation><quadrant>x</quadrant><radius>0.038</radius></WrapSphere>"""
ELLIPSOID = """<WrapEllipsoid name="kneecap"><active>true</active><xyz_body_rotation>0 0 0</xyz_body_rotation>
 <translation>0.02 -0.4 0.005</translation><quadrant>x</quadrant><dimensions>0.036 0.045 0.04</dimensions>
 </WrapEllipsoid>"""
TORUS = """<WrapTorus name="kneecap"><active>true</active><xyz_body_rotation>1.57 0 0</xyz_body_rotation>
 <translation>0.02 -0.36 0.005</translation><quadrant>all</quadrant><inner_radius>0.03</inner_radius>
 <outer_radius>0.05</outer_radius></WrapTorus>"""
#: Muscle, surface, the largest difference of its length from OpenSim's (m), and how far OpenSim's may be from
#: the shortest ones (m, root mean square): OpenSim replaces a torus by a cylinder.
CASES = {
    "sphere": ("recfem_l", "kneecap", SPHERE, 1e-9, 0.5e-3),
    "ellipsoid": ("recfem_l", "kneecap", ELLIPSOID, 5e-6, 0.5e-3),
    "torus": ("recfem_l", "kneecap", TORUS, 1e-6, 15e-3),
}


def write_with_surface(folder, muscle, wrap, surface):
    """Write a subject one of whose muscles wraps round a surface."""
    person = write_subject(folder)
    surfaces = f'<WrapObjectSet name="wrapobjectset"><objects>{surface}</objects></WrapObjectSet>'
    model = MODEL.replace('<Body name="femur_l">', f'<Body name="femur_l">{surfaces}')
    at = model.index("</GeometryPath>", model.index(f'Muscle name="{muscle}"'))
    entry = f"""<PathWrapSet><objects><PathWrap name="wrap_{wrap}"><wrap_object>{wrap}</wrap_object>
    <method>hybrid</method></PathWrap></objects></PathWrapSet>"""
    (person / "model.osim").write_text(model[:at] + entry + model[at:], encoding="utf-8")
    return person


def test_boxes_hold_what_paths_do_not_depend_on():
    """The bounds of an ellipsoid, a torus and a sphere in a model with all kinds of surfaces."""
    assert parameter_names(["WrapSphere", "WrapCylinder"]) == PARAMETERS[:6]
    names = parameter_names(["WrapSphere", "WrapEllipsoid"])
    assert names == PARAMETERS
    for kind, freed in PARAMETERS_OF.items():
        lower, upper = parameter_box(0.01, kind, names)
        held = np.array([name not in freed for name in names])
        np.testing.assert_array_equal(lower == upper, held)
        np.testing.assert_array_equal(lower[held], NOMINAL_PARAMETERS[held])
    lower, upper = parameter_box(0.01, "WrapEllipsoid", names)
    np.testing.assert_allclose(upper[6:], [MAX_ROTATION, SHAPE_FACTORS[1], SHAPE_FACTORS[1]])
    assert (lower[:3] == -0.01).all()


def test_variables_are_those_of_each_surface(tmp_path):
    """A muscle that wraps round two surfaces, of which one is shared with another muscle."""
    parameters = model_parameters(load_subject(write_subject(tmp_path / "plain")))
    classes = {"ball": "WrapSphere", "belly": "WrapEllipsoid"}
    wraps = freed_wraps([["ball", "belly"], ["belly"]], {"ball": 0.01, "belly": 0.02}, classes, PARAMETERS)
    variables = free_variables(
        parameters, with_wraps(nga_freedom(parameters), "PGA", wraps), ["one", "other"]
    )
    own = [label for label in variables.labels if label.split(".")[0] in classes]
    assert own == [f"{wrap}.{name}" for wrap, kind in classes.items() for name in PARAMETERS_OF[kind]]
    assert (variables.upper > variables.lower).all() and np.isfinite(variables.prior_precision).all()
    shared = variables.index[0, -9:]
    np.testing.assert_array_equal(shared, variables.index[1, -18:-9])
    held = variables.index[0, -18:-9] == variables.count
    np.testing.assert_array_equal(held, [name not in PARAMETERS_OF["WrapSphere"] for name in PARAMETERS])


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_personalised_model_has_the_paths_of_the_calibration(case, tmp_path):
    """OpenSim's lengths in the written model are those of the engine with the calibrated surface."""
    muscle, wrap, surface, tolerance, from_shortest = CASES[case]
    subject = load_subject(write_with_surface(tmp_path / "person", muscle, wrap, surface))
    run = tmp_path / "PGA"
    arguments = ["calibrate", str(subject.folder), "--method", "PGA", "--geometry", "engine", "--starts", "1"]
    assert main([*arguments, "--out", str(run), "--quiet"]) == 0
    assert_reproduces_itself(run, subject)
    (found,) = load_run(run).wraps.values()
    rows = [line.split(",") for line in (run / "parameters.csv").read_text().splitlines()]
    assert [row[2] for row in rows if row[1] == "wrap"] == list(PARAMETERS_OF[f"Wrap{case.capitalize()}"])
    engine = ExactPaths(describe_model(subject.model_file), (muscle,), subject.trials.coordinates)
    columns = [subject.trials.coordinates.index(name) for name in engine.coordinates]
    poses = np.moveaxis(subject.trials.angles[:, columns], 1, -1).reshape(-1, len(columns))
    written, nominal = (
        analyse_muscles(file, engine.muscles, engine.coordinates, poses).length[:, 0]
        for file in (run / "model_personalized.osim", subject.model_file)
    )
    posed = engine.posed(poses)[muscle]
    parity, shortest = (
        jax.tree.map(lambda leaf: leaf[0], wrap_at_samples(posed, found[None, None], *wrapping))
        for wrapping in ((PARITY,), ())
    )
    assert parity.touching.mean() > 0.3
    np.testing.assert_allclose(written, parity.length, atol=tolerance)
    assert np.sqrt(np.mean((written - shortest.length) ** 2)) < from_shortest
    assert np.abs(nominal - written).max() > 1e-4
