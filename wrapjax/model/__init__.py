"""The forward model from EMG and paths to joint moments: parameters, freedoms, alterations."""
