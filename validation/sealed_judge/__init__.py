"""An independent simulator of EMG-driven walking, with known causes of model error."""
