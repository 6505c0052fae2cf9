"""Subject folders: recorded walking, made ready for calculation."""

from wrapjax.subject.describe import Table, describe_subject, render_tables
from wrapjax.subject.external_loads import GroundLoads, read_ground_loads
from wrapjax.subject.folder import Subject, read_subject
from wrapjax.subject.legs import read_legs
from wrapjax.subject.model_file import CoordinateInfo, ModelFile, MuscleParameters, read_model_file
from wrapjax.subject.settings import TrialSettings
from wrapjax.subject.storage import Storage, read_storage, write_storage
from wrapjax.subject.trials import FRAMES, Trials

__all__ = [
    "FRAMES",
    "CoordinateInfo",
    "GroundLoads",
    "ModelFile",
    "MuscleParameters",
    "Storage",
    "Subject",
    "Table",
    "TrialSettings",
    "Trials",
    "describe_subject",
    "read_ground_loads",
    "read_legs",
    "read_model_file",
    "read_storage",
    "read_subject",
    "render_tables",
    "write_storage",
]
