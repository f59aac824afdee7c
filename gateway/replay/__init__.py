"""Runs a controller on what is stored: a database, whose decisions it must repeat, or a user's recording."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.replay.recorded import column_named_twice, columns_of, learnt_columns, rehearse_recording
    from gateway.replay.stored import replay
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".recorded": ("column_named_twice", "columns_of", "learnt_columns", "rehearse_recording"),
            ".stored": ("replay",),
        },
    )

__all__ = ["column_named_twice", "columns_of", "learnt_columns", "rehearse_recording", "replay"]
