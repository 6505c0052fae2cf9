"""A virtual leg in motion, with a wrap moved by calibration, and a reader of the page's numbers."""

import base64
import gzip
import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import opensim
import pytest

from wrapjax.datasets.virtual_person.leg import build_leg_model
from wrapjax.osim.model import describe_model
from wrapjax.report.model_view.page import render_page
from wrapjax.report.model_view.payload import describe_scene
from wrapjax.report.model_view.quantities import Quantity, Series, path_quantities
from wrapjax.report.model_view.scene import Motion, Placement, build_scene
from wrapjax.report.model_view.shown import Shown

COORDINATES = ("hip_flexion_l", "hip_adduction_l", "knee_angle_l", "ankle_angle_l")
#: One muscle whose wrap moves, one with a wrap that stays, one without a wrap.
MUSCLES = ("psoas_l", "gasmed_l", "tibant_l")
MOVED = {"PS_at_brim_l": np.array([0.004, -0.003, 0.002, 0.12, -0.1, 0.9])}
FRAMES = 9


@pytest.fixture(scope="session")
def leg_file(tmp_path_factory):
    opensim.Logger.setLevelString("Off")
    file = tmp_path_factory.mktemp("leg") / "model.osim"
    build_leg_model(file, "l")
    return file


@pytest.fixture(scope="session")
def shown(leg_file):
    phase = np.linspace(0.0, 2.0 * np.pi, FRAMES)
    poses = np.stack(
        [
            0.3 + 0.4 * np.cos(phase),
            0.05 * np.sin(phase),
            0.5 - 0.4 * np.cos(2.0 * phase),
            0.2 * np.sin(phase),
        ],
        axis=1,
    )
    percent = np.linspace(0.0, 100.0, FRAMES)
    motions = tuple(
        Motion(f"cycle {number}", factor * poses, percent, "% of the gait cycle", 0.012 * percent + number)
        for number, factor in enumerate((1.0, 0.7))
    )
    moments = np.full((len(COORDINATES), 2 * FRAMES), 7.5)
    gap = np.where(np.arange(2 * FRAMES) < FRAMES, 4.0, np.nan) * np.ones((len(COORDINATES), 1))
    return Shown(
        title="A leg's <motion> </script>",
        under="Before & after.",
        model_file=leg_file,
        model=describe_model(leg_file),
        muscles=MUSCLES,
        coordinates=COORDINATES,
        motions=motions,
        placements=(Placement("before"), Placement("after", MOVED)),
        quantities=(
            Quantity(
                "moment", "Joint moment", "N m", ("coordinate",), (Series("measured", moments, "measured"),)
            ),
            Quantity(
                "gap",
                "Explainable error",
                "N m",
                ("coordinate",),
                (Series("error", gap, "main"),),
                "sequential",
                False,
            ),
        ),
        coloring="moment_arm",
        notes=("<b>Note</b>.",),
    )


@pytest.fixture(scope="session")
def scene(shown):
    return build_scene(shown.model, shown.muscles, shown.coordinates, shown.motions, shown.placements)


@pytest.fixture(scope="session")
def page(shown):
    return render_page(shown)


@dataclass(frozen=True)
class Numbers:
    """The page's JSON, and the arrays that it refers to."""

    content: dict[str, Any]
    block: bytes

    def array(self, reference: dict[str, Any]) -> np.ndarray:
        return np.frombuffer(
            self.block, np.dtype(reference["type"]).newbyteorder("<"), reference["count"], reference["at"]
        )

    def path(self, muscle: str, placement: int, frame: int) -> np.ndarray:
        """Vertices of a muscle's path relative to the root body, m."""
        own = next(one for one in self.content["muscles"] if one["name"] == muscle)["paths"]
        stored = own[min(placement, len(own) - 1)]
        counts = self.array(stored["counts"])
        first = int(counts[:frame].sum())
        vertices = self.array(stored["vertices"]).reshape(-1, 3)[first : first + counts[frame]]
        return vertices * self.content["step"]


def numbers_of(page: str) -> Numbers:
    content = re.search(r'id="content">(.*?)</script>', page, flags=re.S)
    block = re.search(r'id="block">(.*?)</script>', page, flags=re.S)
    return Numbers(json.loads(content[1]), gzip.decompress(base64.b64decode(block[1])))


@pytest.fixture(scope="session")
def numbers(page):
    return numbers_of(page)


@pytest.fixture(scope="session")
def described(shown, scene):
    quantities = (*path_quantities(scene, {}), *shown.quantities)
    return describe_scene(shown, scene, quantities, ())
