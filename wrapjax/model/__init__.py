"""The forward model, its parameter tree and the freedoms."""

from wrapjax.model.alteration import Alteration as Alteration
from wrapjax.model.alteration import MuscleAlteration as MuscleAlteration
from wrapjax.model.alteration import MuscleInputs as MuscleInputs
from wrapjax.model.alteration import altered_emg as altered_emg
from wrapjax.model.alteration import altered_moments as altered_moments
from wrapjax.model.alteration import altered_paths as altered_paths
from wrapjax.model.alteration import fiber_parameters as fiber_parameters
from wrapjax.model.alteration import muscle_parts as muscle_parts
from wrapjax.model.forward import MuscleState as MuscleState
from wrapjax.model.forward import Recording as Recording
from wrapjax.model.forward import joint_moments as joint_moments
from wrapjax.model.forward import muscle_state_along as muscle_state_along
from wrapjax.model.forward import muscle_states as muscle_states
from wrapjax.model.freedom import Freedom as Freedom
from wrapjax.model.freedom import FreedParameter as FreedParameter
from wrapjax.model.freedom import FreedPaths as FreedPaths
from wrapjax.model.freedom import FreedWraps as FreedWraps
from wrapjax.model.freedom import nga as nga
from wrapjax.model.freedom import with_paths as with_paths
from wrapjax.model.freedom import with_wraps as with_wraps
from wrapjax.model.parameters import QUANTITIES as QUANTITIES
from wrapjax.model.parameters import ModelParameters as ModelParameters
from wrapjax.model.parameters import initial_parameters as initial_parameters
from wrapjax.model.variables import Variables as Variables
from wrapjax.model.variables import free_variables as free_variables
