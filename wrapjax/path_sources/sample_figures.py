"""Figures of sampled muscle paths that were accepted as physiological or rejected."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from wrapjax.errors import InputError, Problem
from wrapjax.geometry.engine import GEODESIC, ExactPaths
from wrapjax.geometry.physiological import PhysiologicalThresholds, measure_paths
from wrapjax.geometry.training_samples import plan_samples
from wrapjax.osim.model import describe_model
from wrapjax.path_sources.exact import WRAPPINGS
from wrapjax.path_sources.fit_poses import SMOOTH_POSES, fit_poses
from wrapjax.path_sources.sample_analysis import EngineAnalyzer
from wrapjax.subject.subject import Subject

if TYPE_CHECKING:
    from wrapjax.path_sources.polynomial_fit import Fit
    from wrapjax.report.fit_wraps import SampledPath

#: Number of samples for a single figure, and for each figure of a report.
_SAMPLES, REPORTED_SAMPLES = 250, 150


def physiological_picture(
    subject: Subject,
    fit: Fit,
    muscle: str,
    thresholds: PhysiologicalThresholds | None = None,
) -> str:
    """Draw sampled paths of a muscle: which were accepted as physiological, and why others were rejected.

    Parameters
    ----------
    subject
        Subject of the fit.
    fit
        Fit with samples of the wrap parameters, from `wrapjax.fit_wraps`.
    muscle
        Name of the muscle.
    thresholds
        Definition of physiological paths, by default that of the fit. Other thresholds can be inspected here
        before a fit with them.

    Returns
    -------
    str
        Figure as SVG.

    Raises
    ------
    InputError
        If the muscle has no samples of wrap parameters.
    """
    from wrapjax.report.fit_wraps import physiological_figure
    from wrapjax.report.style import to_svg

    (path,) = sampled_paths(subject, fit, [muscle], thresholds)
    return to_svg(physiological_figure(path))


def sampled_paths(
    subject: Subject,
    fit: Fit,
    muscles: Sequence[str],
    thresholds: PhysiologicalThresholds | None = None,
    *,
    count: int = _SAMPLES,
) -> Iterator[SampledPath]:
    """Compute the paths of muscles for the first samples of their wrap parameters, muscle by muscle.

    Samples are classified in all training poses, as in the fit; the returned curves are those of the cycle
    among these poses.

    Parameters
    ----------
    subject, fit, thresholds
        See `physiological_picture`.
    muscles
        Names of the muscles.
    count
        Number of samples.

    Yields
    ------
    SampledPath
        Curves and reasons for rejection of one muscle.
    """
    from wrapjax.report.fit_wraps import SampledPath

    wraps_of = {} if fit.wraps is None else {name: own for name, own in fit.wraps.wraps_of.items() if own}
    for muscle in muscles:
        if muscle not in wraps_of:
            raise InputError(Problem(str(subject.folder), "has no sampled cylinders to draw", place=muscle))
    if fit.wraps is None or not muscles:
        return
    training, _ = plan_samples(wraps_of, fit.wraps.translations, fit.seed)
    moved = training.together.moved
    samples = replace(training.together, moved={wrap: own[:count] for wrap, own in moved.items()})
    # All muscles and poses, as in the fit, so that compiled functions are reused.
    engine = ExactPaths(describe_model(subject.model_file), list(wraps_of), fit.surrogate.coordinates)
    poses = {"training": fit_poses(subject, engine.coordinates, fit.seed).training}
    posed = {name: engine.posed(own) for name, own in poses.items()}
    source = EngineAnalyzer(engine, poses, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    for muscle in muscles:
        found, nominal = source.paths(muscle, samples, "training")
        length, moment_arm = (np.asarray(part)[:, SMOOTH_POSES] for part in (found.length, found.moment_arm))
        nominal_arm = np.asarray(nominal.moment_arm)[0, SMOOTH_POSES]
        spanned = {engine.coordinates[slot]: slot for slot in fit.surrogate.slots(muscle)}
        yield SampledPath(
            muscle=muscle,
            nominal=np.asarray(nominal.length)[0, SMOOTH_POSES],
            nominal_arms={name: nominal_arm[:, slot] for name, slot in spanned.items()},
            length=length,
            moment_arms={name: moment_arm[:, :, slot] for name, slot in spanned.items()},
            faults=measure_paths(found, nominal, SMOOTH_POSES).failed_criteria(
                thresholds or fit.wraps.thresholds
            ),
        )
