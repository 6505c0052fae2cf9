"""A musculoskeletal model as plain data, and where its bodies and path points are in a pose.

Neither OpenSim nor JAX: a model is extracted once, and everything here is names and NumPy arrays.
"""

from wrapjax.skeleton.description import ModelDescription as ModelDescription
from wrapjax.skeleton.kinematics import BodyMotion as BodyMotion
from wrapjax.skeleton.kinematics import CoordinateValues as CoordinateValues
from wrapjax.skeleton.kinematics import body_motion as body_motion
from wrapjax.skeleton.points import PathPoints as PathPoints
from wrapjax.skeleton.points import path_points as path_points
