"""A running gateway as a Python object, for programs of others (docs/client.md)."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.client.machine import ANSWER_LIMIT_S, Machine, MachineError
else:
    __getattr__ = on_first_use(__name__, {".machine": ("ANSWER_LIMIT_S", "Machine", "MachineError")})

__all__ = ["ANSWER_LIMIT_S", "Machine", "MachineError"]
