"""One muscle: excitation, activation, fiber and tendon force."""

from wrapjax.muscle.activation import DEACTIVATION_RATIO as DEACTIVATION_RATIO
from wrapjax.muscle.activation import muscle_activation as muscle_activation
from wrapjax.muscle.activation import neural_activation as neural_activation
from wrapjax.muscle.compliant_tendon import compliant_tendon_fiber as compliant_tendon_fiber
from wrapjax.muscle.curves import HILL_CURVES as HILL_CURVES
from wrapjax.muscle.curves import AbstractCurves as AbstractCurves
from wrapjax.muscle.curves import HillCurves as HillCurves
from wrapjax.muscle.excitation import CommandSplines as CommandSplines
from wrapjax.muscle.excitation import EmgSpline as EmgSpline
from wrapjax.muscle.excitation import fit_emg_spline as fit_emg_spline
from wrapjax.muscle.excitation import sharpened as sharpened
from wrapjax.muscle.excitation import within_unit as within_unit
from wrapjax.muscle.hill import FiberState as FiberState
from wrapjax.muscle.hill import rigid_tendon_fiber as rigid_tendon_fiber
