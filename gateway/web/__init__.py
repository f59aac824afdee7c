"""The page for operators: a read-only subscriber that shows in a browser how the machines are."""

from gateway.web.access import check_certificate, check_listening
from gateway.web.app import build_app
from gateway.web.passwords import make_hash
from gateway.web.settings import MachineUse, WebSettings, load_settings
from gateway.web.site import SiteSeen, SiteSubscription, listened_to

__all__ = [
    "MachineUse",
    "SiteSeen",
    "SiteSubscription",
    "WebSettings",
    "build_app",
    "check_certificate",
    "check_listening",
    "listened_to",
    "load_settings",
    "make_hash",
]
