"""Published spread of the muscle parameters between people, as priors of a diagnosis.

A calibration allows parameters a wide range, so that it can fit any person. A diagnosis asks whether an
effect is needed, and parameters that no anatomy supports would explain its signature away. Freed parameters
are therefore held by the spread that anatomical and physiological studies found, about the values of the
model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wrapjax.model.freedom import FreedLaw, Freedom, FreedParameter


@dataclass(frozen=True)
class PublishedSpread:
    """Standard deviation of a parameter between people, its prior mean where not the model's, and the source.

    ``sd`` is in the parameter's unit, or relative to the prior mean.
    """

    sd: float
    relative: bool
    source: str


#: Spread of each freed parameter of a muscle.
PUBLISHED_SPREAD: dict[str, PublishedSpread] = {
    "optimal_fiber_length": PublishedSpread(
        0.15,
        relative=True,
        source="fiber lengths of 21 cadavers, 8 to 25 % of the mean: Ward et al. 2009, "
        "doi:10.1007/s11999-008-0594-8",
    ),
    "tendon_slack_length": PublishedSpread(
        0.04,
        relative=True,
        source="fiber lengths in the anatomical posture, 10 to 20 %, with tendons two to four times as long: "
        "Ward et al. 2009, doi:10.1007/s11999-008-0594-8",
    ),
    "electromechanical_delay": PublishedSpread(
        0.025, relative=False, source="delays of 20 to 100 ms: Zhou et al. 1995, doi:10.1007/BF00235103"
    ),
    "activation_time_constant": PublishedSpread(
        0.40,
        relative=True,
        source="time constants of 10 to 30 ms: Winters 1990, doi:10.1007/978-1-4613-9030-5_5",
    ),
    "emg_scale": PublishedSpread(
        0.60,
        relative=True,
        source="activation at the largest EMG of walking, a tenth to all of the maximum: Perry 2010",
    ),
}
#: Standard deviation of every moment arm about the scaled model's, m: difference of moment arms between
#: scaled and subject-specific models (Scheys et al. 2008, doi:10.1016/j.gaitpost.2008.04.004).
MOMENT_ARM_SD = 0.0015


def with_published_priors(freedom: Freedom) -> Freedom:
    """Give the freed parameters of a calibration the published spread, and free the person's muscle law."""
    return replace(
        freedom,
        parameters=tuple(_with_published_prior(parameter) for parameter in freedom.parameters),
        law=FreedLaw.published(),
    )


def _with_published_prior(parameter: FreedParameter) -> FreedParameter:
    spread = PUBLISHED_SPREAD.get(parameter.name)
    if spread is None:
        return parameter
    sd = (
        spread.sd * np.abs(parameter.prior_mean)
        if spread.relative
        else np.full_like(parameter.prior_sd, spread.sd)
    )
    return replace(parameter, prior_sd=np.minimum(sd, parameter.prior_sd))
