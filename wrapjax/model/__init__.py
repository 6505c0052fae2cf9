"""Forward model from EMG and muscle paths to joint moments: parameters, freedoms, alterations."""
