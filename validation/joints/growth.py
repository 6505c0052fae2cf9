"""Measure how time and memory of joint personalisation grow with frames and unknowns.

Run it as ``python -m validation.joints.growth`` (``WRAPJAX_DATA``). One Gauss-Newton step of the estimation
is timed after compilation: inverse kinematics of all frames, derivatives, and elimination of the poses.
Memory is the peak of the process so far, so that frames are measured in ascending order. Frames are those of
the recorded walk, repeated.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from wrapjax.jax_setup import set_up_jax
from wrapjax.joints.changed_skeleton import skeleton_change
from wrapjax.joints.estimation import JointProblem
from wrapjax.joints.freed_parameters import PriorWidths, default_parameters, spanned_joints
from wrapjax.joints.problem import PreparedProblem, prepare_problem
from wrapjax.joints.settings import JointSettings, MarkerTrial


def seconds_of_a_step(problem: JointProblem) -> float:
    """Time of one linearisation after compilation, s."""
    start = jnp.zeros(problem.lower.size)
    jax.block_until_ready(problem.linearized_at(start))
    began = time.perf_counter()
    jax.block_until_ready(problem.linearized_at(start))
    return time.perf_counter() - began


def with_unknowns(prepared: PreparedProblem, count: int) -> JointProblem:
    """Free the first so many values."""
    description, names, problem = prepared.description, prepared.names, prepared.problem
    joints = spanned_joints(description, names)
    freed = default_parameters(description, names, joints, PriorWidths(), scales="axes")[:count]
    return replace(
        problem,
        change=skeleton_change(description, problem.model, names, freed),
        sd=np.array([entry.sd for entry in freed]),
        limits=(np.array([entry.lower for entry in freed]), np.array([entry.upper for entry in freed])),
    )


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure growth with frames and unknowns.")
    parser.add_argument("--frames", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--unknowns", type=int, nargs="+", default=[10, 50, 100, 200])
    options = parser.parse_args()
    set_up_jax()
    folder = Path(os.environ["WRAPJAX_DATA"]) / "markers_walk"
    settings = JointSettings(
        file=folder,
        name="walk",
        model_file=folder / "RajagopalLaiUhlrich2023.osim",
        marker_set=folder / "markerset_walk.xml",
        trials=(MarkerTrial("walk", folder / "motion_capture_walk.trc"),),
        skin_movement=0.0,
        frames=96,
    )
    prepared = prepare_problem(settings)
    problem = with_unknowns(prepared, 80)
    for count in options.unknowns:
        seconds = seconds_of_a_step(with_unknowns(prepared, count))
        print(f"96 frames, {count} unknowns: {seconds:.3f} s a step", flush=True)
    for count in options.frames:
        blocks = -(-count // problem.frames.precision.shape[1])
        rows = np.arange(blocks) % problem.frames.precision.shape[0]
        frames = jax.tree.map(lambda array, rows=rows: np.asarray(array)[rows], problem.frames)
        seconds = seconds_of_a_step(replace(problem, frames=frames))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{count} frames, {problem.sd.size} unknowns: {seconds:.2f} s a step "
            f"({1e3 * seconds / count:.2f} ms a frame), peak {peak:.0f} MiB",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
