"""What errors a model has without any effect: noise, errors of its inputs, and muscles without EMG."""
