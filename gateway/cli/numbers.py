"""Formats measured values for people."""


def shown(value: float) -> str:
    """Two decimals, but never 0.00 for what is not 0: 2e-41 degC is a wrong byte order, not a cold day."""
    return f"{value:.2f}" if value == 0 or 0.01 <= abs(value) < 1e5 else f"{value:.3g}"
