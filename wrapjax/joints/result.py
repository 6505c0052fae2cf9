"""Result of joint personalisation: changes, how sure they are, marker errors, and its files."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from wrapjax.calibration.solvers.interface import Status
from wrapjax.errors import InputError
from wrapjax.geometry.skeleton.model_description import Joint, ModelDescription
from wrapjax.io.files import new_folder, write_json, write_text
from wrapjax.joints.freed_parameters import AXES, FRAME_KINDS, FreedParameter
from wrapjax.joints.identifiability import Posterior, place_spreads
from wrapjax.joints.settings import JointSettings
from wrapjax.preprocessing.inverse_kinematics import InverseKinematics

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset


@dataclass(frozen=True)
class TrialErrors:
    """Marker errors of a trial before and after personalisation.

    Parameters
    ----------
    name, use
        Name, and ``calibration`` or ``validation``.
    used
        Whether the estimation could use each frame; others are held out.
    before, after
        Inverse kinematics with the starting and with the personalised model, of all frames.
    """

    name: str
    use: str
    used: Bool[np.ndarray, " frame"]
    before: InverseKinematics
    after: InverseKinematics


@dataclass(frozen=True)
class JointPersonalisation:
    """Model with joints personalised from markers.

    Parameters
    ----------
    settings
        Settings.
    before, after
        Description of the starting and of the personalised model.
    model
        Bytes of the personalised model's file.
    parameters
        Freed parameters.
    values
        Their values, in their units; zero is the starting model.
    posterior
        Posterior standard deviations, and what is not determined.
    trials
        Marker errors of each trial.
    noise
        Standard deviation of a marker's coordinate, m, estimated from the residuals.
    independent_frames
        Number of frames that are independent of each other, by the correlation time of the residuals.
    status
        Reason why the solver stopped.
    seconds
        Time of the whole computation, s.
    """

    settings: JointSettings
    before: ModelDescription
    after: ModelDescription
    model: bytes
    parameters: tuple[FreedParameter, ...]
    values: Float[np.ndarray, " parameter"]
    posterior: Posterior
    trials: tuple[TrialErrors, ...]
    noise: float
    independent_frames: float
    status: Status
    seconds: float

    @property
    def rms(self) -> dict[str, float | None]:
        """Root mean square distances of markers, m: on frames used and held out, before and after."""
        return {
            "before": self._rms("before", held_out=False),
            "after": self._rms("after", held_out=False),
            "held_out_before": self._rms("before", held_out=True),
            "held_out_after": self._rms("after", held_out=True),
        }

    def _rms(self, when: str, *, held_out: bool) -> float | None:
        parts = [getattr(trial, when).distances[:, trial.used != held_out].ravel() for trial in self.trials]
        joined = np.concatenate(parts)
        joined = joined[np.isfinite(joined)]
        return float(np.sqrt(np.mean(joined**2))) if joined.size else None

    def summary(self) -> dict[str, Any]:
        """Return the content of ``joints.json``."""
        return {
            "schema": 1,
            "subject": self.settings.name,
            "converged": self.status.converged,
            "message": self.status.value,
            "seconds": self.seconds,
            "rms_mm": {name: None if value is None else 1e3 * value for name, value in self.rms.items()},
            "trials": {trial.name: _trial_summary(trial) for trial in self.trials},
            "joints": self._joints(),
            "scales": {name: self._other("scale", name) for name in self._owners(("scale",))},
            "markers": {name: self._other("marker", name) for name in self._owners(("marker",))},
            "undetermined": [
                parameter.name
                for parameter, known in zip(self.parameters, self.posterior.determined, strict=True)
                if not known
            ],
            "undetermined_directions": [
                {"information": direction.information, "components": direction.components}
                for direction in self.posterior.directions
            ],
            "noise_mm": 1e3 * self.noise,
            "independent_frames": self.independent_frames,
            "at_bounds": [
                parameter.name
                for parameter, value in zip(self.parameters, self.values, strict=True)
                if not parameter.lower < value < parameter.upper
            ],
        }

    def to_dataset(self) -> Dataset:
        """Return freed values with their uncertainty, and marker distances, as an `xarray.Dataset`."""
        from wrapjax.report.labelled.geometry import joints_dataset

        return joints_dataset(self)

    def plot_markers(self) -> Figure:
        """Draw the root mean square distance of every marker before and after, mm."""
        from wrapjax.report.joints_page import marker_figure

        return marker_figure(self.trials)

    def plot_changes(self) -> Figure:
        """Draw what changed in every joint, with 90 % intervals."""
        from wrapjax.report.joints_page import change_figure

        return change_figure(self)

    def save(self, folder: Path | str, *, force: bool = False, motion: bool = False) -> None:
        """Write ``joints.json``, ``model_joints.osim`` and ``report.html`` atomically.

        Parameters
        ----------
        folder
            Folder to create.
        force
            Replace an existing folder.
        motion
            If muscles span its joints, also write ``motion.html``, which shows it in three dimensions with
            its axes before and after; takes seconds.

        Raises
        ------
        InputError
            If the folder exists and ``force`` is false.
        """
        from wrapjax.report.joints_page import render_joints
        from wrapjax.report.model_view.page import write_beside_report
        from wrapjax.report.model_view.results import personalised_joints

        with new_folder(Path(folder), force=force) as temporary:
            (temporary / "model_joints.osim").write_bytes(self.model)
            write_json(temporary / "joints.json", self.summary())
            link = ""
            if motion:
                names = self._owners(FRAME_KINDS)
                before = {joint.name: joint.in_parent for joint in self.before.joints if joint.name in names}
                # A model may have no muscles, of whose paths the page consists.
                with suppress(InputError):
                    shown = personalised_joints(temporary / "model_joints.osim", self.settings.name, before)
                    link = write_beside_report(temporary, shown)
            write_text(temporary / "report.html", render_joints(self, link))

    def entries(self, kind: str, owner: str) -> list[tuple[FreedParameter, float, float, bool]]:
        """Parameters of one part: parameter, value, posterior standard deviation, and whether determined."""
        rows = zip(
            self.parameters,
            self.values.tolist(),
            self.posterior.sd.tolist(),
            self.posterior.determined.tolist(),
            strict=True,
        )
        return [row for row in rows if row[0].kind == kind and row[0].owner == owner]

    def _owners(self, kinds: Iterable[str]) -> list[str]:
        return list(dict.fromkeys(entry.owner for entry in self.parameters if entry.kind in kinds))

    def _joints(self) -> dict[str, dict[str, Any]]:
        """Describe the personalised joints, by name."""
        names = self._owners(FRAME_KINDS)
        started = [entry for entry in self.before.joints if entry.name in names]
        spreads = place_spreads(started, self.parameters, self.posterior)
        return {entry.name: self._joint(entry, spreads[entry.name]) for entry in started}

    def _joint(self, start: Joint, spread: dict[str, Any]) -> dict[str, Any]:
        """Describe a joint: poses of its frames, changes, standard deviations, and what markers determine."""
        name = start.name
        joint = next(entry for entry in self.after.joints if entry.name == name)
        poses = {"parent": joint.in_parent, "child": joint.in_child}
        content: dict[str, Any] = {
            "coordinates": list(joint.coordinates),
            "spread": spread,
            "before": {
                "translation_m": list(start.in_parent.translation),
                "orientation_rad": _xyz_angles(start.in_parent.rotation),
            },
            "translation_m": {side: list(pose.translation) for side, pose in poses.items()},
            "orientation_rad": {side: _xyz_angles(pose.rotation) for side, pose in poses.items()},
            "change": {},
            "sd": {},
            "determined": {},
        }
        for kind in FRAME_KINDS:
            side, quantity = kind.split("_")
            unit = "orientation_rad" if quantity == "orientation" else "translation_m"
            for parameter, value, sd, known in self.entries(kind, name):
                axis = AXES[parameter.axis]
                for key, number in (("change", value), ("sd", sd), ("determined", known)):
                    content[key].setdefault(unit, {}).setdefault(side, {})[axis] = number
        return content

    def _other(self, kind: str, owner: str) -> dict[str, Any]:
        """Describe the scale of a body or the place of a marker."""
        rows = self.entries(kind, owner)
        names = ["xyz" if row[0].axis < 0 else AXES[row[0].axis] for row in rows]
        content: dict[str, Any] = {}
        if kind == "scale":
            content["factor"] = {name: 1.0 + row[1] for name, row in zip(names, rows, strict=True)}
        else:
            marker = next(entry for entry in self.after.markers if entry.name == owner)
            content["location_m"] = list(marker.location)
            content["change_m"] = {name: row[1] for name, row in zip(names, rows, strict=True)}
        content["sd"] = {name: row[2] for name, row in zip(names, rows, strict=True)}
        content["determined"] = {name: row[3] for name, row in zip(names, rows, strict=True)}
        return content


def _trial_summary(trial: TrialErrors) -> dict[str, Any]:
    used = {"used": trial.used, "held_out": ~trial.used}
    return {
        "use": trial.use,
        "frames": int(trial.used.size),
        "rms_mm": {
            f"{name}_{when}": 1e3 * float(np.sqrt(np.nanmean(fit.distances[:, rows] ** 2)))
            for name, rows in used.items()
            if rows.any()
            for when, fit in (("before", trial.before), ("after", trial.after))
        },
        "markers_rms_mm": {
            name: [
                1e3 * float(np.sqrt(np.nanmean(fit.distances[row] ** 2)))
                if np.isfinite(fit.distances[row]).any()
                else None
                for fit in (trial.before, trial.after)
            ]
            for row, name in enumerate(trial.before.markers)
        },
    }


def _xyz_angles(rotation: Any) -> list[float]:
    """Body-fixed x-y-z angles of a rotation matrix, rad."""
    matrix = np.asarray(rotation)
    y = np.arcsin(np.clip(matrix[0, 2], -1.0, 1.0))
    x = np.arctan2(-matrix[1, 2], matrix[2, 2])
    z = np.arctan2(-matrix[0, 1], matrix[0, 0])
    return [float(x), float(y), float(z)]
