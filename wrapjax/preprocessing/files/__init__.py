"""A laboratory's files: settings, markers, angles, dynamometer, and what one recording consists of."""
