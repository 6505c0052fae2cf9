"""Projects of the NMSM Pipeline: read as subjects, and its parameter files written."""

from wrapjax.nmsm.muscle_analysis import MuscleAnalysis, read_muscle_analyses
from wrapjax.nmsm.osimx import OSIMX_QUANTITIES, OsimxMuscle, osimx_text, read_osimx
from wrapjax.nmsm.project import Project, Recorded, fill_subject_folder, read_project
from wrapjax.nmsm.settings import ToolSettings, read_tool_settings

__all__ = [
    "OSIMX_QUANTITIES",
    "MuscleAnalysis",
    "OsimxMuscle",
    "Project",
    "Recorded",
    "ToolSettings",
    "fill_subject_folder",
    "osimx_text",
    "read_muscle_analyses",
    "read_osimx",
    "read_project",
    "read_tool_settings",
]
