"""Thermal Adaptive Learning Control: the science. Arrays in, arrays out; no I/O, no clock, no logging."""
