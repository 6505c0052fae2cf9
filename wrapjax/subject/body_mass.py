"""Comparison of the body mass in the settings with the mass of the model, to find wrong units and models."""

from __future__ import annotations

#: Largest accepted difference between the person's mass and that of the scaled model, as a share of the
#: latter.
MAX_MASS_DIFFERENCE = 0.10
#: Pounds in a kilogram.
POUNDS_PER_KG = 2.2046


def mass_agrees_with_model(mass_kg: float, model_kg: float) -> bool:
    """Return whether the person's and the model's mass (kg) agree; true if the model's is NaN."""
    return not abs(mass_kg / model_kg - 1.0) > MAX_MASS_DIFFERENCE if model_kg > 0.0 else True


def mass_looks_like_pounds(mass_kg: float, model_kg: float) -> bool:
    """Return whether the person's mass, given as kg, is the model's mass in pounds."""
    return model_kg > 0.0 and abs(mass_kg / model_kg / POUNDS_PER_KG - 1.0) <= MAX_MASS_DIFFERENCE


def describe_masses(mass_kg: float, model_kg: float) -> str:
    """Describe both masses (kg) and their ratio in a clause."""
    ratio = mass_kg / model_kg
    return f"mass_kg is {mass_kg:.4g}, {ratio:.3g} times the {model_kg:.4g} kg of all bodies of the model"


def mass_notes(mass_kg: float, model_kg: float) -> tuple[str, ...]:
    """Note a person's mass that is implausible for the model.

    A model that is lighter than the person is accepted, as it may have a leg only, unless the ratio suggests
    pounds.

    Parameters
    ----------
    mass_kg
        Mass of the person, kg.
    model_kg
        Mass of all bodies of the model, kg; NaN if unknown.

    Returns
    -------
    tuple of str
        One sentence, or none.
    """
    pounds = mass_looks_like_pounds(mass_kg, model_kg)
    if mass_agrees_with_model(mass_kg, model_kg) or (mass_kg > model_kg and not pounds):
        return ()
    question = "is it in lb?" if pounds else "is the model scaled to the person?"
    masses = describe_masses(mass_kg, model_kg)
    return (f"{masses}: {question} Forces in bodyweights are divided by mass_kg",)
