"""What a laboratory's inverse dynamics make of wrong inputs: forces, masses and joints that are off."""

from wrapjax.measurement.changes import INDEPENDENT as INDEPENDENT
from wrapjax.measurement.changes import measured_changes as measured_changes
from wrapjax.measurement.changes import recorded_walk as recorded_walk
