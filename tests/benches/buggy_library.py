"""A library with a bug: it raises what nobody expects of it."""

import pytest
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsResponse
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse

_RESPONSES = (ReadCoilsResponse, ReadHoldingRegistersResponse, ExceptionResponse)
"""Answers to functions 1 and 2, to 3 and 4, and to any function."""


class BuggyDecoder:
    """From now on pymodbus raises KeyError for the next `failures` answers, which counts down to 0."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, failures: int) -> None:
        self.failures = failures
        for response in _RESPONSES:
            self._break(monkeypatch, response)

    def _break(self, monkeypatch: pytest.MonkeyPatch, response: type[ModbusPDU]) -> None:
        decode = response.decode

        def buggy(pdu: ModbusPDU, data: bytes) -> None:
            if self.failures:
                self.failures -= 1
                raise KeyError("no such key")
            decode(pdu, data)

        monkeypatch.setattr(response, "decode", buggy)
