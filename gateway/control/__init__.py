"""The grid loop around the pure controller, training and the sensor check."""
