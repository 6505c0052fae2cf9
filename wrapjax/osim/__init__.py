"""OpenSim at arm's length: what a model holds, and how its muscles run at given poses.

Nothing else in wrapjax imports OpenSim, and this does so only when a function is called.
"""

from wrapjax.osim.model import describe_model as describe_model
from wrapjax.osim.model import spanned_coordinates as spanned_coordinates
from wrapjax.osim.muscle_analysis import PathGeometry as PathGeometry
from wrapjax.osim.muscle_analysis import analyse_muscles as analyse_muscles
from wrapjax.osim.muscle_analysis import touching_muscles as touching_muscles
from wrapjax.osim.personalise import MuscleConstants as MuscleConstants
from wrapjax.osim.personalise import write_personalised_model as write_personalised_model
from wrapjax.osim.placed_analysis import analyse_placements as analyse_placements
