"""A CANopen node of the canopen library, made from an EDS."""

from collections.abc import Sequence
from pathlib import Path

import canopen
from canopen.objectdictionary.eds import import_eds

NODE = 5
EDS = """
[FileInfo]
FileName=pump.eds
[DeviceInfo]
VendorName=Somebody \xb5
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x7
AccessType=ro
DefaultValue=0
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=3
[1018sub0]
ParameterName=Highest
ObjectType=0x7
DataType=0x5
AccessType=ro
DefaultValue=2
[1018sub1]
ParameterName=Vendor
ObjectType=0x7
DataType=0x7
AccessType=ro
DefaultValue=0x17
[1018sub2]
ParameterName=Product
ObjectType=0x7
DataType=0x7
AccessType=ro
DefaultValue=0x194
[2100]
ParameterName=Temperatures
ObjectType=0x8
SubNumber=3
[2100sub0]
ParameterName=Highest
ObjectType=0x7
DataType=0x5
AccessType=ro
DefaultValue=2
[2100sub1]
ParameterName=Bearing
ObjectType=0x7
DataType=0x3
AccessType=ro
DefaultValue=-215
[2100sub2]
ParameterName=Oil
ObjectType=0x7
DataType=0x8
AccessType=ro
DefaultValue=41.5
[2200]
ParameterName=Name
ObjectType=0x7
DataType=0x9
AccessType=ro
DefaultValue=pump
[2201]
ParameterName=Set point
ObjectType=0x7
DataType=0x4
AccessType=wo
"""


class LibraryNode:
    """A node of the canopen library on an emulated adapter: it takes and gives frames, and needs no thread."""

    def __init__(self, eds: Path) -> None:
        with eds.open(encoding="cp1252") as file:
            dictionary = import_eds(file, NODE)  # type: ignore[no-untyped-call]
        self._network = canopen.Network()
        self._given: list[tuple[int, bytes]] = []
        self._network.send_message = self._give  # type: ignore[method-assign]
        self.local = self._network.create_node(NODE, dictionary)

    def on_frame(self, identifier: int, data: bytes) -> Sequence[tuple[int, bytes]]:
        self._given.clear()
        self._network.notify(identifier, bytearray(data), 0.0)
        return list(self._given)

    def _give(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._given.append((can_id, bytes(data)))
