"""Read OpenSim's functions of one variable as plain data."""

from __future__ import annotations

from typing import Any

from wrapjax.skeleton.functions import Function, Polynomial, Spline


def read_function(opensim: Any, function: Any) -> Function | None:
    """Read a function, or return None for a kind that is not known here.

    Known are Constant, LinearFunction, PolynomialFunction, SimmSpline, and a MultiplierFunction of them.
    """
    kind = function.getConcreteClassName()
    if kind == "MultiplierFunction":
        multiplier = opensim.MultiplierFunction.safeDownCast(function)
        inner = read_function(opensim, multiplier.getFunction())
        return None if inner is None else inner.scaled(multiplier.getScale())
    if kind == "Constant":
        return Polynomial((opensim.Constant.safeDownCast(function).getValue(),))
    if kind == "LinearFunction":
        line = opensim.LinearFunction.safeDownCast(function)
        return Polynomial((line.getSlope(), line.getIntercept()))
    if kind == "PolynomialFunction":
        coefficients = opensim.PolynomialFunction.safeDownCast(function).getCoefficients()
        return Polynomial(tuple(coefficients.get(index) for index in range(coefficients.size())))
    if kind == "SimmSpline":
        return _spline(opensim, opensim.SimmSpline.safeDownCast(function))
    return None


def _spline(opensim: Any, spline: Any) -> Spline:
    knots = [spline.getX(index) for index in range(spline.getSize())]
    first = opensim.StdVectorInt([0])
    slopes = []
    for knot in knots:
        at = opensim.Vector(1, float(knot))
        slopes.append(spline.calcDerivative(first, at))
    return Spline(tuple(knots), tuple(spline.getY(index) for index in range(len(knots))), tuple(slopes))
