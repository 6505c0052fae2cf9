"""Pictures of sampled paths, so that a person can agree, or not, with what counts as physiological."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wrapjax.api.exact import WRAPPINGS
from wrapjax.api.fit_result import Fit
from wrapjax.api.fitting import SMOOTH_POSES, fit_poses
from wrapjax.api.wrap_sources import EngineSource
from wrapjax.errors import InputError, Problem
from wrapjax.geometry.engine import GEODESIC, ExactPaths
from wrapjax.geometry.physiological import DEFAULT_THRESHOLDS, PhysiologicalThresholds, measure_paths
from wrapjax.geometry.wrap_samples import plan_samples
from wrapjax.osim import describe_model
from wrapjax.subject import Subject

#: Samples that are analysed for a picture.
_SAMPLES = 250


def physiological_picture(
    subject: Subject,
    fit: Fit,
    muscle: str,
    thresholds: PhysiologicalThresholds = DEFAULT_THRESHOLDS,
) -> str:
    """Draw which samples of a muscle's cylinders were accepted, and what others were rejected for.

    Parameters
    ----------
    subject, fit
        A fit of this subject that has sampled its cylinders.
    muscle
        Name.
    thresholds
        What counts as physiological; try others here before fitting with them.

    Returns
    -------
    str
        SVG.
    """
    from wrapjax.report.physiological_figure import physiological_figure
    from wrapjax.report.style import to_svg

    if fit.wraps is None or not fit.wraps.wraps_of.get(muscle):
        raise InputError(Problem(str(subject.folder), "has no sampled cylinders to draw", place=muscle))
    wraps_of = {name: wraps for name, wraps in fit.wraps.wraps_of.items() if wraps}
    training, _ = plan_samples(wraps_of, fit.wraps.translations, fit.seed)
    moved = training.together.moved
    samples = replace(training.together, moved={wrap: own[:_SAMPLES] for wrap, own in moved.items()})
    engine = ExactPaths(describe_model(subject.model_file), [muscle], fit.surrogate.coordinates)
    poses = {"training": fit_poses(subject, engine.coordinates, fit.seed).training}
    posed = {name: engine.posed(own) for name, own in poses.items()}
    source = EngineSource(engine, poses, posed, WRAPPINGS.get(fit.geometry, GEODESIC))
    found, nominal = source.paths(muscle, samples, "training")
    length, moment_arm = (np.asarray(part)[:, SMOOTH_POSES] for part in (found.length, found.moment_arm))
    slots = fit.surrogate.slots(muscle)
    names = [engine.coordinates[slot] for slot in slots]
    usual = np.asarray(nominal.moment_arm)[0, SMOOTH_POSES]
    return to_svg(
        physiological_figure(
            muscle,
            np.asarray(nominal.length)[0, SMOOTH_POSES],
            {name: usual[:, slot] for name, slot in zip(names, slots, strict=True)},
            length,
            {name: moment_arm[:, :, slot] for name, slot in zip(names, slots, strict=True)},
            measure_paths(found, nominal, SMOOTH_POSES).faults(thresholds),
        )
    )
