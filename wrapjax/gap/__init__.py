"""Effects that the model leaves out: what they are, and what they would do to the moments."""

from wrapjax.gap.catalogue import CATALOGUE as CATALOGUE
from wrapjax.gap.catalogue import catalogue as catalogue
from wrapjax.gap.catalogue import effects_in as effects_in
from wrapjax.gap.context import AtBound as AtBound
from wrapjax.gap.context import Context as Context
from wrapjax.gap.context import MeasuredChange as MeasuredChange
from wrapjax.gap.context import OtherMuscles as OtherMuscles
from wrapjax.gap.context import PathChanges as PathChanges
from wrapjax.gap.effect import FAMILIES as FAMILIES
from wrapjax.gap.effect import Effect as Effect
from wrapjax.gap.effect import EffectParameter as EffectParameter
from wrapjax.gap.effect import Effects as Effects
from wrapjax.gap.effect import NotTestable as NotTestable
from wrapjax.gap.effect import Variant as Variant
from wrapjax.gap.prediction import predicted_moments as predicted_moments
from wrapjax.gap.prediction import secants as secants
from wrapjax.gap.prediction import signatures as signatures
