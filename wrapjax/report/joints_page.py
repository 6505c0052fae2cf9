"""Report of joint personalisation as a self-contained HTML page."""

from __future__ import annotations

from wrapjax.joints.result import JointPersonalisation
from wrapjax.report import markup


def render_joints(result: JointPersonalisation) -> str:
    """Render the page."""
    return markup.page(f"Joints of {result.settings.name}", [])
