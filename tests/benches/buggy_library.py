"""A library with a bug: it raises what nobody expects of it."""

import pytest
from pymodbus.pdu import DecodePDU, ModbusPDU


class BuggyDecoder:
    """From now on pymodbus raises KeyError for the next `failures` answers, which counts down to 0."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, failures: int) -> None:
        self.failures = failures
        decode = DecodePDU.decode

        def buggy(decoder: DecodePDU, frame: bytes) -> ModbusPDU | None:
            if self.failures:
                self.failures -= 1
                raise KeyError("no such key")
            return decode(decoder, frame)

        monkeypatch.setattr(DecodePDU, "decode", buggy)
