"""A machine for tests of what is around it."""


class StillMachine:
    """A machine that does not deform."""

    def tool_deviation_um(self, *_: float) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0
