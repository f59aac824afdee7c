"""The room that the page reserves for the verdict, so that another verdict moves nothing.

These are the texts that may stand in each place. The browser lays all of them out, unseen, so each place is as large as
the longest in this language needs at this width.
"""

from typing import Final

WORDS: Final = ("word.ready", "word.unsure", "word.not_ready", "word.unknown", "word.no_tolerance", "word.probing",
                "word.no_data", "word.old", "word.gone", "word.silent", "word.never", "word.lost",
                "word.full", "word.connecting")  # fmt: skip
"""One of them stands there."""

TOLERANCE: Final = ("tool.typed", "tool.declared", "tool.none")
"""One of them stands below the tolerance."""
SINCE: Final = ("since.at", "since.before")

BECAUSE: Final = ("because.left", "because.no_good", "because.not_taken", "because.bounded", "because.no_estimate",
                  "because.no_measurement")  # fmt: skip
"""One of them stands there while the page shows what helps. Other texts for this place, such as that the gateway is
gone, are longer, and take the room of what helps as well."""

HELPS: Final[tuple[tuple[str, ...], ...]] = (
    (
        "when.no_forecast",
        "when.not_checked",
        "when.not_within",
        "when.ready",
        "when.not_before",
        "when.stays",
        "when.stays_unknown",
        "when.not_foreseeable",
    ),
    ("help.best", "help.nothing", "help.measure", "help.measure_not_enough"),
    ("help.stop",),
    ("when.next_measurement",),
)
"""All of these lines may stand there, each with one of its sentences."""
AFAR: Final = 2
"""This many of them, from the first on, can be read from two metres."""

WHAT: Final = ("help.wait", "help.probe", "help.warm")
OPTION: Final = ("help.little", "help.enough", "help.option", "help.unforeseeable")
"""One of them for each of WHAT, below the others."""

PLANNED: Final = ("planned.ready", "planned.stays", "planned.may_leave", "planned.not_certain", "planned.not_checked",
                  "planned.unknown")  # fmt: skip
"""One of them for each planned load, below the others."""

ORDER_NOTICES: Final = ("notice.disarmed", "notice.paused")
"""Both may stand between the verdict and what helps then, HELPS_ORDERED and PLANNED."""

HELPS_ORDERED: Final = (HELPS[0], HELPS[-1])
"""As HELPS, while an order stands."""

NOTES: Final = ("tool.not_written", "tool.not_following")
"""At most one of them stands below the errors at the tool."""

CHART: Final = ("chart.nothing", "chart.legend")
"""One of them stands below the charts."""
