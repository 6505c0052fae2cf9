"""How far the error shrinks: effects fitted together with what is calibrated, on cycles kept back."""
