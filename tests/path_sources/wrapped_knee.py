"""A model whose anterior muscle wraps round a cylinder at the knee."""

from tests.subject.synthetic import MODEL

#: Cylinder at the knee of the synthetic thigh, over which the anterior muscle wraps.
CYLINDER = """<WrapObjectSet><objects><WrapCylinder name="knee_front_l">
 <quadrant>x</quadrant><translation>0 -0.4 0</translation><radius>0.055</radius><length>0.1</length>
</WrapCylinder></objects></WrapObjectSet></Body>"""
WRAP = """</PathPointSet><PathWrapSet><objects><PathWrap name="over_knee">
 <wrap_object>knee_front_l</wrap_object></PathWrap></objects></PathWrapSet></GeometryPath>"""


def wrapped_model():
    thigh, shank, rest = MODEL.split("</Body>", 2)
    front, behind = rest.split("</PathPointSet></GeometryPath>", 1)
    return f"{thigh}{CYLINDER}{shank}</Body>{front}{WRAP}{behind}"
