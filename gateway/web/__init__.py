"""The page for operators: a subscriber that shows the state of the machines in a browser, and signs commands of users
whose keys its settings name."""

from gateway.web.access import check_certificate, check_listening
from gateway.web.app import build_app
from gateway.web.settings import MachineUse, WebSettings, load_settings

__all__ = [
    "MachineUse",
    "WebSettings",
    "build_app",
    "check_certificate",
    "check_listening",
    "load_settings",
]
