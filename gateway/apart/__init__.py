"""Runs long computations in a separate process, so that the buses keep their periods.

The process runs at a lower priority than the gateway, in a control group of lower weight where there is one.
`python -m gateway.apart` is that process.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.apart.control_group import UndividedError, divide
    from gateway.apart.process import WorkError, apart
else:
    __getattr__ = on_first_use(
        __name__,
        {".control_group": ("UndividedError", "divide"), ".process": ("WorkError", "apart")},
    )

__all__ = ["UndividedError", "WorkError", "apart", "divide"]
