"""A fit of muscle paths for a terminal, muscle by muscle and cylinder by cylinder."""

from __future__ import annotations

from wrapjax.api.paths.fitting import Fit
from wrapjax.api.paths.wrap_fit import WrapFit


def fit_table(fit: Fit) -> str:
    """Show the errors of a fit, muscle by muscle."""
    titles = ("wrapped", "terms", "length RMSE", "length max", "arm RMSE", "arm max")
    lines = [
        "Errors on poses never used in fitting, mm (moment arms pooled over coordinates)",
        f"{'muscle':16s}" + "".join(f"{title:>13s}" for title in titles),
    ]
    for name, error in fit.errors.items():
        errors = (
            error.length_rmse_mm,
            error.length_max_mm,
            error.moment_arm_rmse_mm,
            error.moment_arm_max_mm,
        )
        wrapped = "yes" if error.wrapped else "no"
        lines.append(
            f"{name:16s}{wrapped:>13s}{error.terms:13d}" + "".join(f"{value:13.3f}" for value in errors)
        )
    return "\n".join(lines)


def wrap_table(wraps: WrapFit) -> str:
    """Show how a fit's cylinders fared, one by one."""
    titles = ("box", "physiological", "accuracy", "let through", "touched")
    lines = [
        "Cylinders, on samples never used in fitting: half width of the box (mm), share of it that leaves",
        "paths physiological, balanced accuracy of the limit, share of other samples that it lets through",
        f"{'cylinder':24s}" + "".join(f"{title:>15s}" for title in titles),
    ]
    for name, quality in wraps.quality.items():
        shares = (quality.physiological_share, quality.balanced_accuracy, quality.false_physiological)
        columns = "".join(f"{'-':>15s}" if share is None else f"{share:15.3f}" for share in shares)
        touched = "yes" if name in wraps.touched else "no"
        lines.append(f"{name:24s}{1e3 * wraps.translations[name]:15.1f}{columns}{touched:>15s}")
    return "\n".join(lines)
