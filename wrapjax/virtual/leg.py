"""The virtual leg as an OpenSim model."""

from __future__ import annotations

from pathlib import Path

from wrapjax.osim.virtual_leg import LegModel, write_leg_model
from wrapjax.virtual.anatomy import BODIES, CYLINDERS, JOINTS
from wrapjax.virtual.mirror import mirrored
from wrapjax.virtual.muscles import MUSCLES

LEG = LegModel(
    name="virtual_leg",
    credits="Built by wrapjax from published figures; no person's leg.",
    publications=(
        "Attachments, architecture, joints: Delp et al. 1990, doi:10.1109/10.102791. "
        "Knee: Yamaguchi and Zajac 1989, doi:10.1016/0021-9290(89)90179-6. "
        "Inertia: de Leva 1996, doi:10.1016/0021-9290(95)00178-6. "
        "Wrapping after Arnold et al. 2010, doi:10.1007/s10439-009-9852-5."
    ),
    bodies=BODIES,
    joints=JOINTS,
    cylinders=CYLINDERS,
    muscles=MUSCLES,
)


def build_leg_model(path: Path, side: str = "r") -> None:
    """Write the virtual leg's OpenSim model (``.osim``): always the same bytes.

    A leg of 6 degrees of freedom, 31 muscles and 10 wrapping cylinders; the pelvis is welded to the
    ground at the height of standing. The left leg (side ``l``) is the right one (``r``) in a mirror.
    """
    write_leg_model({"r": LEG, "l": mirrored(LEG)}[side], Path(path))
