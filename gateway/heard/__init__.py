"""What the machines of a site publish, as a read-only subscriber holds it."""

from gateway.heard.hearing import Hearing
from gateway.heard.machine import (
    KEPT,
    OLD_S,
    Applied,
    Estimated,
    Explained,
    MachineSeen,
    MeasuredErrors,
    applied,
    believable,
    instant,
    is_old,
    nine,
)
from gateway.heard.site import SiteSeen, SiteSubscription, listened_to

__all__ = [
    "KEPT",
    "OLD_S",
    "Applied",
    "Estimated",
    "Explained",
    "Hearing",
    "MachineSeen",
    "MeasuredErrors",
    "SiteSeen",
    "SiteSubscription",
    "applied",
    "believable",
    "instant",
    "is_old",
    "listened_to",
    "nine",
]
