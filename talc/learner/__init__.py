"""Thermal errors as weighted lags of the inputs, learnt at every measurement by a mixture of Kalman filters."""
