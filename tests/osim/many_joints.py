"""Synthetic model with a joint of every class, and functions of every class on the axes of custom joints."""

import pytest

#: Number of coordinates of each class of joint, in the order of the chain.
JOINTS = {"Free": 6, "Ball": 3, "Pin": 1, "Slider": 1, "Universal": 2, "Gimbal": 3, "Planar": 3, "Weld": 0}


def _points(kind, points, more=""):
    xs, ys = (" ".join(str(point[place]) for point in points) for place in range(2))
    return f"<{kind}>{more}<x>{xs}</x><y>{ys}</y></{kind}>"


def _gcv_spline(degree):
    points = [
        (-1.0, 0.1),
        (-0.4, 0.3),
        (0.0, -0.1),
        (0.3, 0.2),
        (0.9, 0.5),
        (1.1, 0.2),
        (1.4, 0.0),
        (1.6, 0.1),
    ]
    more = f"<half_order>{(degree + 1) // 2}</half_order><error_variance>0</error_variance>"
    return _points("GCVSpline", points, more)


_SPLINE = _points("SimmSpline", [(-1.0, 0.0), (0.0, 0.2), (0.5, 0.1), (1.2, 0.4)])
_LINE = "<LinearFunction><coefficients>{} {}</coefficients></LinearFunction>".format
_CONSTANT = "<Constant><value>{}</value></Constant>".format
_PIECES = [(-0.8, 0.1), (0.1, 0.5), (0.7, -0.2), (1.0, 0.3)]
#: Functions and axes of the custom joints: three rotations, three translations.
CUSTOM = [
    [
        (_LINE(1.0, 0.0), "0 0 1"),
        (_SPLINE, "0 2 0.5"),
        (_CONSTANT(0.2), "1 0 0.1"),
        (_gcv_spline(3), "1 0 0"),
        (_gcv_spline(5), "0 1 0"),
        (_gcv_spline(7), "0 0.6 0.8"),
    ],
    [
        (
            "<PolynomialFunction><coefficients>0.1 -0.3 0.5 0.02</coefficients></PolynomialFunction>",
            "1 0 0",
        ),
        (_points("PiecewiseLinearFunction", _PIECES), "0 1 0"),
        (_LINE(-0.7, 0.1), "0 0 1"),
        (
            f"<MultiplierFunction><function>{_SPLINE}</function><scale>1.7</scale></MultiplierFunction>",
            "1 0 0",
        ),
        (_points("PiecewiseConstantFunction", _PIECES), "0 1 0"),
        (_LINE(1.0, 0.0), "0 0 1"),
    ],
]


def _coordinates(names):
    entries = "".join(
        f'<Coordinate name="{name}"><default_value>0.05</default_value><range>-9 9</range></Coordinate>'
        for name in names
    )
    return f"<coordinates>{entries}</coordinates>"


def _frame(name, body, translation, orientation):
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>{body}</socket_parent>'
        f"<translation>{translation}</translation><orientation>{orientation}</orientation></PhysicalOffsetFrame>"
    )


def _joint(kind, name, parent, child, coordinates, more=""):
    return (
        f'<{kind}Joint name="{name}"><socket_parent_frame>in_parent</socket_parent_frame>'
        f"<socket_child_frame>in_child</socket_child_frame>{_coordinates(coordinates)}<frames>"
        f"{_frame('in_parent', parent, '0.1 0.2 -0.05', '0.2 -0.3 0.5')}"
        f"{_frame('in_child', child, '-0.03 0.15 0.02', '-0.4 0.1 0.3')}</frames>{more}</{kind}Joint>"
    )


def _axes(axes, coordinate):
    text = ""
    for (function, direction), name in zip(
        axes, (f"{kind}{n}" for kind in ("rotation", "translation") for n in (1, 2, 3)), strict=True
    ):
        driven = "" if function.startswith("<Constant") else coordinate
        text += (
            f'<TransformAxis name="{name}"><coordinates>{driven}</coordinates><axis>{direction}</axis>'
            f"{function}</TransformAxis>"
        )
    return f"<SpatialTransform>{text}</SpatialTransform>"


def _coupler(dependent, independent):
    return (
        f'<CoordinateCouplerConstraint name="{dependent}_coupler">'
        f"<coupled_coordinates_function>{_SPLINE}</coupled_coordinates_function>"
        f"<independent_coordinate_names>{independent}</independent_coordinate_names>"
        f"<dependent_coordinate_name>{dependent}</dependent_coordinate_name></CoordinateCouplerConstraint>"
    )


def many_joints_text():
    """Write a chain of bodies with a joint of each class, markers, and a coupler of a coupled coordinate."""
    bodies, joints, markers, parent = "", "", "", "/ground"
    for number, kind in enumerate((*JOINTS, 0, 1)):
        bodies += f'<Body name="body{number}"><mass>1</mass><inertia>0.1 0.1 0.1 0 0 0</inertia></Body>'
        child = f"/bodyset/body{number}"
        markers += (
            f'<Marker name="marker{number}"><socket_parent_frame>{child}</socket_parent_frame>'
            f"<location>0.1 {-0.02 * number} 0.03</location></Marker>"
        )
        if isinstance(kind, int):
            axes = _axes(CUSTOM[kind], f"turn{kind}")
            joints += _joint("Custom", f"custom{kind}", parent, child, [f"turn{kind}"], axes)
        else:
            names = [f"{kind.lower()}{place}" for place in range(JOINTS[kind])]
            joints += _joint(kind, f"{kind.lower()}_joint", parent, child, names)
        parent = child
    couplers = _coupler("pin0", "turn0") + _coupler("universal0", "pin0")
    return (
        '<?xml version="1.0" encoding="UTF-8"?><OpenSimDocument Version="40600"><Model name="many_joints">'
        f"<BodySet><objects>{bodies}</objects></BodySet><JointSet><objects>{joints}</objects></JointSet>"
        f"<ConstraintSet><objects>{couplers}</objects></ConstraintSet>"
        f"<MarkerSet><objects>{markers}</objects></MarkerSet></Model></OpenSimDocument>"
    )


@pytest.fixture(scope="session")
def many_joints(tmp_path_factory):
    """File of the synthetic model."""
    file = tmp_path_factory.mktemp("many") / "model.osim"
    file.write_text(many_joints_text(), encoding="utf-8")
    return file
