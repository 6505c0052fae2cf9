"""How well modelled moments match measured ones."""

from wrapjax.evaluate.metrics import MomentErrors as MomentErrors
from wrapjax.evaluate.metrics import moment_errors as moment_errors
from wrapjax.evaluate.metrics import pooled_mae as pooled_mae
