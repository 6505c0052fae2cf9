"""Bodies, joints and coordinates of a model, by NumPy: description, kinematics, changed joints."""
