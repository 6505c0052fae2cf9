"""Coverage of 90 % intervals of parameters: ``python -m validation.calibration.interval_coverage``.

The true parameters of a virtual subject are known. Its moments get new noise for each repeat (smooth within a
cycle, independent between cycles), and it is calibrated starting from the true parameters, so that the
coverage is that of the spread around this minimum and of the pull by priors. Data follow the model exactly:
there is no model error.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import pin_threads
from wrapjax.jax_setup import set_up_jax

#: Standard deviation of the Gaussian that smooths noise, frames, as for the virtual subject.
_WIDTH = 3.8


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m validation.calibration.interval_coverage", description=__doc__
    )
    parser.add_argument("--repeats", type=int, default=40, metavar="N", help="noise draws (default: 40)")
    parser.add_argument(
        "--bootstraps",
        type=int,
        default=0,
        metavar="N",
        help="noise draws with a bootstrap, too (default: 0)",
    )
    parser.add_argument(
        "--draws", type=int, default=50, metavar="N", help="draws of each bootstrap (default: 50)"
    )
    parser.add_argument(
        "--noise", type=float, default=2.0, metavar="NM", help="noise of moments, N m (default: 2)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the subject (default: 0)")
    parser.add_argument(
        "--limit",
        type=float,
        default=np.inf,
        metavar="SECONDS",
        help="time after which no further draw is started",
    )
    parser.add_argument(
        "--subject", type=Path, metavar="DIR", help="folder of a virtual subject (default: simulated)"
    )
    options = parser.parse_args()
    pin_threads(1)
    set_up_jax()
    if options.subject:
        return _measure(options.subject, options)
    from wrapjax.datasets.virtual_person.virtual_subject import write_virtual_subject

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "person"
        write_virtual_subject(folder, seed=options.seed, emg_noise=0.0, moment_noise=0.0)
        return _measure(folder, options)


def _measure(folder: Path, options: argparse.Namespace) -> int:
    import jax.numpy as jnp
    from scipy.ndimage import gaussian_filter1d

    from wrapjax.calibration.problem import build_objective
    from wrapjax.calibration.solvers.augmented_lagrangian import AugmentedLagrangian
    from wrapjax.calibration.uncertainty.posterior import posterior
    from wrapjax.calibration.uncertainty.uncertainty import randomized_refits
    from wrapjax.datasets.virtual_person.true_parameters import parameter_names, read_true_parameters
    from wrapjax.model.forward import joint_moments
    from wrapjax.subject.subject import load_subject as load_subject

    subject = load_subject(folder)
    problem = build_objective(subject, "NGA")
    base = problem.variables.base
    truth = read_true_parameters(folder)
    true = replace(base, **{name: jnp.asarray(getattr(truth, name)) for name in parameter_names()})
    at = np.asarray(problem.variables.pack(true))
    clean = np.asarray(joint_moments(problem.curves, true, problem.recording))
    speeds = [subject.trials.used_for("calibration").speeds]
    solver = AugmentedLagrangian()
    coverage: dict[str, list[Any]] = {"laplace": [], "bootstrap": []}
    began = time.monotonic()
    for number in range(options.repeats):
        if time.monotonic() - began > options.limit:
            break
        noise = np.random.default_rng([options.seed, number]).normal(size=clean.shape)
        smooth = gaussian_filter1d(noise, _WIDTH, axis=-1, mode="wrap")
        measured = clean + options.noise * smooth / smooth.std()
        noisy = replace(problem, measured=jnp.asarray(measured))
        solution = solver.solve(noisy, at)
        laplace = posterior(solution.problem, solution.state, speeds)
        if number == 0:
            before = laplace.sample_prior(500, number).std(axis=0)
        coverage["laplace"].append(_interval_coverage(laplace.laplace(500, number), before, laplace, at))
        if number < options.bootstraps:
            drawn, _ = randomized_refits(laplace, solver, options.draws, number)
            coverage["bootstrap"].append(_interval_coverage(drawn, before, laplace, at))
        noises = ", ".join(f"{sd:.2f}" for sd in laplace.noise[0].deviation)
        print(
            f"{number}: {solution.status.name}, cost {solution.cost:.4g}, noise {noises} N m, "
            f"information {laplace.information:.0f}",
            flush=True,
        )
    for way, rows in coverage.items():
        if rows:
            print(f"\n{way}, {len(rows)} noise draws, {options.noise:g} N m: coverage of 90 % intervals,")
            print(
                "by ratio of posterior to prior standard deviation, and by kind of parameter for ratios < 0.8"
            )
            _report(problem.variables.labels, *(np.stack(part) for part in zip(*rows, strict=True)))
    if coverage["bootstrap"]:
        pairs = zip(coverage["laplace"], coverage["bootstrap"], strict=False)
        ratio = np.concatenate([(two[2] / one[2])[one[1] < 0.5] for one, two in pairs])
        low, middle, high = np.percentile(ratio, [5, 50, 95])
        print(
            "\nstandard deviation by bootstrap over that by Laplace, parameters with a ratio of at most 0.5: "
            f"median {middle:.2f}, 5 to 95 % {low:.2f} to {high:.2f}"
        )
    return 0


def _interval_coverage(
    draws: np.ndarray, before: np.ndarray, laplace: Any, true: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whether intervals contain the true values, posterior over prior SD, and posterior SD."""
    from wrapjax.calibration.uncertainty.intervals import summarize_draws

    labels = tuple("" for _ in true)
    spread = summarize_draws(draws, draws, laplace.solution, laplace.at_bound, labels, labels)
    held = (spread.low <= true) & (true <= spread.high)
    return held, spread.deviation / before, spread.deviation


def _report(labels: tuple[str, ...], held: np.ndarray, share: np.ndarray, deviation: np.ndarray) -> None:
    kinds = np.array([label.rsplit(".", 1)[1] for label in labels])
    for low, high in ((0.0, 0.3), (0.3, 0.5), (0.5, 0.8), (0.0, 0.8), (0.8, np.inf)):
        chosen = (share >= low) & (share < high)
        if chosen.any():
            print(f"  ratio {low:.1f} to {high:.1f}: {_share(held, chosen)}")
    for kind in dict.fromkeys(kinds):
        chosen = (share < 0.8) & (kinds == kind)
        if chosen.any():
            print(f"  {kind}: {_share(held, chosen)}")


def _share(held: np.ndarray, chosen: np.ndarray) -> str:
    return f"{held[chosen].mean():.3f} of {chosen.sum() / len(held):.0f} parameters"


if __name__ == "__main__":
    raise SystemExit(main())
