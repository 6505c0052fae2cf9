"""Personalisation of a model's joints from markers (`personalize_joints`)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from wrapjax.calibration.solvers.levenberg_marquardt import ProjectedLevenbergMarquardt
from wrapjax.joints.estimation import JointProblem
from wrapjax.joints.freed_parameters import (
    FRAME_KINDS,
    FreedParameter,
)
from wrapjax.joints.identifiability import posterior
from wrapjax.joints.nmsm_settings import read_nmsm_settings
from wrapjax.joints.noise import estimate_noise, next_round
from wrapjax.joints.problem import prepare_problem, solve_trial
from wrapjax.joints.result import JointPersonalisation, TrialErrors
from wrapjax.joints.settings import JointSettings, read_joint_settings
from wrapjax.osim.model import describe_model
from wrapjax.osim.personalised_joints import JointChanges, write_model_with_joints

#: Most rounds of estimation; each begins with the noise of the one before.
ROUNDS = 6
#: The rounds end where the noise falls by a smaller share. Where it rises, further rounds would trust the
#: markers less and less.
NOISE_TOLERANCE = 0.05
#: Solver: the posterior is far wider than these tolerances.
SOLVER = ProjectedLevenbergMarquardt(gtol=1e-5, ftol=1e-8, max_iterations=80)


def personalize_joints(
    settings: JointSettings | Path | str, *, log: Callable[[str], None] = lambda line: None
) -> JointPersonalisation:
    """Personalise joint frames, body scales and marker places of a model from recorded markers.

    The cost is the sum of squared marker distances, in units of their noise, over the frames of all trials
    with the poses eliminated, plus squared changes in units of their prior standard deviations. Noise and its
    correlation in time are estimated from the residuals. What markers do not determine keeps its prior, and
    is named in the result.

    Parameters
    ----------
    settings
        Settings, their TOML file, a folder that holds ``joints.toml``, or settings of the NMSM Pipeline's
        joint model personalization (.xml).
    log
        Function called with each line of progress.

    Returns
    -------
    JointPersonalisation
        Changes with their posterior standard deviations, marker errors before and after, and the model.

    Raises
    ------
    InputError
        With all faults of the files: unknown joints, joints that no marker spans, markers in another unit,
        left and right exchanged, files of two people.

    Examples
    --------
    >>> wrapjax.personalize_joints("lab.toml").save("joints")  # doctest: +SKIP
    """
    settings = settings if isinstance(settings, JointSettings) else read_settings(Path(settings))
    began = time.perf_counter()
    prepared = prepare_problem(settings, log)
    solved, names, parameters = prepared.recordings, prepared.names, prepared.parameters
    problem, counts = prepared.problem, prepared.counts
    log(f"estimating {len(parameters)} parameters")
    first, variables, noise, independent = problem, np.zeros(problem.lower.size), np.inf, 0.0
    for number in range(ROUNDS):
        if number:
            problem = next_round(first, problem, variables, noise, independent)
        solution = SOLVER.solve(problem, variables)
        log(f"{solution.iterations} iterations, {time.perf_counter() - began:.1f} s")
        variables, before = solution.variables, noise
        matrix = np.asarray(solution.linearization.gauss_newton)
        noise, independent = estimate_noise(problem, variables, matrix, counts)
        log(f"round {number + 1}: noise {1e3 * noise:.2f} mm, {independent:.0f} independent frames")
        if noise > (1.0 - NOISE_TOLERANCE) * before:
            break
    changes = joint_changes(problem, parameters, names, variables)
    with tempfile.TemporaryDirectory(prefix="wrapjax-") as folder:
        written = Path(folder) / "model_joints.osim"
        write_model_with_joints(settings.model_file, written, changes, settings.marker_set)
        changed = describe_model(written)
        content = written.read_bytes()
    log("inverse kinematics with the personalised joints")
    errors = tuple(
        TrialErrors(
            name=entry.trial.name,
            use=entry.trial.use,
            used=entry.used,
            before=entry.kinematics,
            after=solve_trial(settings, changed, entry.trial, entry.markers),
        )
        for entry in solved
    )
    known = posterior(parameters, matrix, prepared.combination)
    return JointPersonalisation(
        settings=settings,
        before=prepared.description,
        after=changed,
        model=content,
        parameters=tuple(parameters),
        values=prepared.combination @ np.asarray(problem.parameters(variables)),
        posterior=known,
        trials=errors,
        noise=noise,
        independent_frames=independent,
        status=solution.status,
        seconds=time.perf_counter() - began,
    )


def read_settings(file: Path) -> JointSettings:
    """Read settings of joint personalisation: TOML, a folder that holds it, or the NMSM Pipeline's XML."""
    return read_nmsm_settings(file) if file.suffix.lower() == ".xml" else read_joint_settings(file)


def joint_changes(
    problem: JointProblem,
    parameters: Sequence[FreedParameter],
    names: Sequence[str],
    variables: Float[np.ndarray, " variable"],
) -> JointChanges:
    """Collect the changes of frames, scales and markers for the model's file."""
    structure, change = problem.model.structure, problem.change
    values = np.asarray(problem.parameters(variables))
    changed = change.apply(problem.model, values)
    skeleton = changed.skeleton
    scales = 1.0 + np.asarray(change.scales @ values)
    scaled = {parameter.owner for parameter in parameters if parameter.kind == "scale"}
    moved = {parameter.owner for parameter in parameters if parameter.kind in FRAME_KINDS}
    placed = {parameter.owner for parameter in parameters if parameter.kind == "marker"}
    rows = {name: structure.joints.index(name) for name in structure.joints if name in moved}

    def frame(kind: str, row: int) -> tuple[np.ndarray, np.ndarray]:
        rotation, origin = (getattr(skeleton, f"{kind}_{part}")[row] for part in ("rotation", "origin"))
        return np.asarray(rotation), np.asarray(origin)

    return JointChanges(
        scales={body: scales[structure.bodies.index(body)] for body in structure.bodies if body in scaled},
        frames={name: (frame("parent", row), frame("child", row)) for name, row in rows.items()},
        markers={
            name: np.asarray(changed.locations)[row] for row, name in enumerate(names) if name in placed
        },
    )
