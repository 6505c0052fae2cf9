"""The page itself: one HTML file that opens without a network, from a template and a vendored library."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from wrapjax.errors import InputError
from wrapjax.io.files import write_text
from wrapjax.osim.bones import Bone, attached_meshes, find_bones, geometry_folders
from wrapjax.report import markup
from wrapjax.report.model_view.payload import describe_scene, to_script
from wrapjax.report.model_view.quantities import path_quantities
from wrapjax.report.model_view.scene import build_scene
from wrapjax.report.model_view.shown import Shown
from wrapjax.report.provenance import versions_in_words

#: Name of the page beside the report of a result.
PAGE = "motion.html"

_LARGEST_PAGE = 15 << 20
# Most bones that are named where their files are missing; a whole body has eighty.
_LISTED = 6
_LICENSE_OF_LIBRARY = "three/LICENSE"


def write_beside_report(folder: Path, shown: Shown) -> str:
    """Write the page of a result into its folder, and a line for the result's report that links to it.

    Parameters
    ----------
    folder
        Folder of the result.
    shown
        Content of the page.

    Returns
    -------
    str
        HTML; empty if the model moves in a way that the page cannot show, and no page was written.
    """
    try:
        page = render_page(shown)
    except InputError:
        # The result itself does without the exact path engine.
        return ""
    write_text(folder / PAGE, page)
    return markup.link_line(
        markup.Link("The model in motion", PAGE), ": bones, muscle paths and wraps in three dimensions."
    )


def render_page(shown: Shown, bone_folders: Sequence[Path] = ()) -> str:
    """Write the page.

    Parameters
    ----------
    shown
        Content of the page.
    bone_folders
        Folders to search for the bones' surfaces before OpenSim's.

    Raises
    ------
    InputError
        If a part of the model moves in an unsupported way, or a bone's file is damaged.
    """
    scene = build_scene(
        shown.model,
        shown.muscles,
        shown.coordinates,
        shown.motions,
        shown.placements,
        shown.joints_before,
    )
    quantities = (*path_quantities(scene, shown.polynomials), *shown.quantities)
    meshes = attached_meshes(shown.model_file)
    bones, missing = find_bones(meshes, (*bone_folders, *geometry_folders(shown.model_file)))
    notes = [*shown.notes, *scene.notes, *_note_on_bones(bones, missing)]
    text = _rendered(shown, describe_scene(shown, scene, quantities, bones), notes)
    if len(text) > _LARGEST_PAGE and bones:
        # Sticks instead of bones whose surfaces are too fine for one page.
        notes.append("The bones' surfaces are too large for this page; lines between joints stand for them.")
        text = _rendered(shown, describe_scene(shown, scene, quantities, ()), notes)
    return text


def _rendered(shown: Shown, described: tuple[dict, str], notes: Sequence[str]) -> str:
    # Imported late, as all that only pages need.
    from markupsafe import Markup

    content, block = described
    own = files("wrapjax.report.model_view")

    def text_of(name: str) -> Markup:
        """Text of a file of this package, which stands in the page as it is."""
        return Markup(own.joinpath(name).read_text(encoding="utf-8"))

    template = markup.environment("wrapjax.report.model_view", "").get_template("page.html.jinja")
    return template.render(
        title=shown.title,
        under=shown.under,
        notes=notes,
        versions=versions_in_words(),
        style=text_of("page.css"),
        library=text_of("three/three.min.js"),
        license=text_of(_LICENSE_OF_LIBRARY),
        script=text_of("page.js"),
        content=Markup(to_script(content)),
        block=block,
    )


def _note_on_bones(bones: Sequence[Bone], missing: Sequence[str]) -> list[str]:
    if not missing:
        return []
    if bones:
        others = f" and {len(missing) - _LISTED} others" if len(missing) > _LISTED else ""
        return [f"Bones whose files were not found: {', '.join(missing[:_LISTED])}{others}."]
    return [
        "The bones' surfaces (Geometry/*.vtp) were not found; lines between joint centers stand for bones."
    ]
