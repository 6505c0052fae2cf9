"""Does the mass that settings give agree with the model? Forces in bodyweights are divided by it."""

from __future__ import annotations

#: By how much the person's mass may differ from that of a model scaled to them, as a share of the latter.
MOST_MASS_ERROR = 0.10
#: Pounds in a kilogram.
POUNDS = 2.2046


def agrees_with_model(mass_kg: float, model_kg: float) -> bool:
    """Say whether a person's mass is that of a scaled model's bodies, both in kg; NaN agrees with all."""
    return not abs(mass_kg / model_kg - 1.0) > MOST_MASS_ERROR if model_kg > 0.0 else True


def looks_like_pounds(mass_kg: float, model_kg: float) -> bool:
    """Say whether what is given as kg is what the model's bodies (kg) are in pounds."""
    return model_kg > 0.0 and abs(mass_kg / model_kg / POUNDS - 1.0) <= MOST_MASS_ERROR


def mass_beside_model(mass_kg: float, model_kg: float) -> str:
    """Tell both masses, kg, and how they compare."""
    times = mass_kg / model_kg
    return f"mass_kg is {mass_kg:.4g}, {times:.3g} times the {model_kg:.4g} kg of all bodies of the model"


def mass_notes(mass_kg: float, model_kg: float) -> tuple[str, ...]:
    """Note a mass that is no person's with this model, though bodies may be left out of the model.

    Parameters
    ----------
    mass_kg
        Of the person.
    model_kg
        Of all bodies of the model, which may be a leg alone: too little of it says nothing, unless it is
        what pounds would look like. NaN where unknown.

    Returns
    -------
    tuple of str
        One sentence, or none.
    """
    pounds = looks_like_pounds(mass_kg, model_kg)
    if agrees_with_model(mass_kg, model_kg) or (mass_kg > model_kg and not pounds):
        return ()
    asked = "is it in lb?" if pounds else "is the model scaled to the person?"
    beside = mass_beside_model(mass_kg, model_kg)
    return (f"{beside}: {asked} Forces in bodyweights are divided by mass_kg",)
