"""A virtual person to demonstrate with: leg, walking and a hidden truth, from published figures."""

from wrapjax.virtual.folder import Series as Series
from wrapjax.virtual.hidden_effects import HIDDEN_EFFECTS as HIDDEN_EFFECTS
from wrapjax.virtual.leg import build_leg_model as build_leg_model
from wrapjax.virtual.subject import DEFAULT_SERIES as DEFAULT_SERIES
from wrapjax.virtual.subject import write_virtual_legs as write_virtual_legs
from wrapjax.virtual.subject import write_virtual_subject as write_virtual_subject
from wrapjax.virtual.truth import VirtualTruth as VirtualTruth
from wrapjax.virtual.truth import read_truth as read_truth
