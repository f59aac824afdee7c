"""The page for operators: a subscriber that shows the state of the machines in a browser.

It signs commands of users whose keys its settings name.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.web.access import check_certificate, check_listening
    from gateway.web.app import build_app
    from gateway.web.settings import MachineUse, WebSettings, load_settings
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".access": ("check_certificate", "check_listening"),
            ".app": ("build_app",),
            ".settings": ("MachineUse", "WebSettings", "load_settings"),
        },
    )

__all__ = [
    "MachineUse",
    "WebSettings",
    "build_app",
    "check_certificate",
    "check_listening",
    "load_settings",
]
