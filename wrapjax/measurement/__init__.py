"""What a laboratory's inverse dynamics make of wrong inputs: forces, masses and joints that are off."""

from wrapjax.measurement.changes import measured_changes as measured_changes
