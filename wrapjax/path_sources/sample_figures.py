"""Pictures of sampled paths, so that a person can agree, or not, with what counts as physiological."""

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

#: Samples that are analysed for a picture, and for each of those in a report.
_SAMPLES, REPORTED_SAMPLES = 250, 150


def physiological_picture(
    subject: Subject,
    fit: Fit,
    muscle: str,
    thresholds: PhysiologicalThresholds | None = None,
) -> str:
    """Draw which samples of a muscle's cylinders were accepted, and what others were rejected for.

    Parameters
    ----------
    subject, fit
        A fit of this subject that has sampled its cylinders.
    muscle
        Name.
    thresholds
        What counts as physiological, by default as for the fit; try others here before fitting with them.

    Returns
    -------
    str
        SVG.
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
    """Lay the paths of the first samples of these muscles' cylinders, one muscle after the other.

    Verdicts are on all training poses, as for the fit; what is given to be drawn is the cycle among them.

    Parameters
    ----------
    subject, fit, thresholds
        As for `physiological_picture`.
    muscles
        Names.
    count
        Number of samples.
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
    # All muscles, and all poses, as when cylinders are sampled: the programs compiled for that serve here.
    engine = ExactPaths(describe_model(subject.model_file), list(wraps_of), fit.surrogate.coordinates)
    poses = {"training": fit_poses(subject, engine.coordinates, fit.seed).training}
    posed = {name: engine.posed(own) for name, own in poses.items()}
    source = EngineAnalyzer(engine, poses, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    for muscle in muscles:
        found, nominal = source.paths(muscle, samples, "training")
        length, moment_arm = (np.asarray(part)[:, SMOOTH_POSES] for part in (found.length, found.moment_arm))
        usual = np.asarray(nominal.moment_arm)[0, SMOOTH_POSES]
        spanned = {engine.coordinates[slot]: slot for slot in fit.surrogate.slots(muscle)}
        yield SampledPath(
            muscle=muscle,
            nominal=np.asarray(nominal.length)[0, SMOOTH_POSES],
            nominal_arms={name: usual[:, slot] for name, slot in spanned.items()},
            length=length,
            moment_arms={name: moment_arm[:, :, slot] for name, slot in spanned.items()},
            faults=measure_paths(found, nominal, SMOOTH_POSES).failed_criteria(
                thresholds or fit.wraps.thresholds
            ),
        )
