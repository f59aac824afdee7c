"""LinuxCNC: settings of a control with the agent of deploy/nc/linuxcnc; drivers.agent communicates with it."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.linuxcnc.settings import LinuxCncSettings
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".settings": ("LinuxCncSettings",),
        },
    )

__all__ = ["LinuxCncSettings"]
