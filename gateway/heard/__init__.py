"""Messages of the machines of a site, as a read-only subscriber holds them."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.heard.hearing import Hearing
    from gateway.heard.instants import instant
    from gateway.heard.machine import (
        Applied,
        Estimated,
        MachineSeen,
        applied,
        believable,
        holds_s,
        is_old,
        nine,
    )
    from gateway.heard.site import SiteSeen, SiteSubscription, listened_to
    from gateway.heard.unreadable import UnreadableMessages
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".hearing": ("Hearing",),
            ".instants": ("instant",),
            ".machine": (
                "Applied",
                "Estimated",
                "MachineSeen",
                "applied",
                "believable",
                "holds_s",
                "is_old",
                "nine",
            ),
            ".site": ("SiteSeen", "SiteSubscription", "listened_to"),
            ".unreadable": ("UnreadableMessages",),
        },
    )

__all__ = [
    "Applied",
    "Estimated",
    "Hearing",
    "MachineSeen",
    "SiteSeen",
    "SiteSubscription",
    "UnreadableMessages",
    "applied",
    "believable",
    "holds_s",
    "instant",
    "is_old",
    "listened_to",
    "nine",
]
