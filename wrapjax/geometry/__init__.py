"""Muscle paths: length, rate and moment arms as functions of joint angles."""

from wrapjax.geometry.feasibility import RAREST_SHARE as RAREST_SHARE
from wrapjax.geometry.feasibility import Feasibility as Feasibility
from wrapjax.geometry.feasibility import FeasibilityQuality as FeasibilityQuality
from wrapjax.geometry.feasibility import feasibility_quality as feasibility_quality
from wrapjax.geometry.feasibility_fit import fit_feasibility as fit_feasibility
from wrapjax.geometry.guarded_paths import GuardedPaths as GuardedPaths
from wrapjax.geometry.guarded_paths import guarded_paths as guarded_paths
from wrapjax.geometry.inner_level import InnerLevel as InnerLevel
from wrapjax.geometry.inner_level import fit_inner_level as fit_inner_level
from wrapjax.geometry.paths import AbstractPath as AbstractPath
from wrapjax.geometry.paths import AdjustablePath as AdjustablePath
from wrapjax.geometry.paths import PathState as PathState
from wrapjax.geometry.paths import fixed_path as fixed_path
from wrapjax.geometry.poses import random_poses as random_poses
from wrapjax.geometry.poses import smooth_poses as smooth_poses
from wrapjax.geometry.surrogate import PathSurrogate as PathSurrogate
from wrapjax.geometry.surrogate import fit_surrogate as fit_surrogate
from wrapjax.geometry.surrogate import surrogate_from as surrogate_from
from wrapjax.geometry.two_level import TwoLevelPaths as TwoLevelPaths
from wrapjax.geometry.two_level import two_level_paths as two_level_paths
