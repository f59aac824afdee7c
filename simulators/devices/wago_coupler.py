"""An emulated WAGO 750 coupler: the process image of its modules, and the registers that name coupler and modules."""

from collections.abc import Mapping, Sequence

from simulators.devices.modbus_unit import ModbusUnit

_SERIES, _MODULES = 0x2011, 0x2030
_MODULE_WORDS = 65


class WagoCoupler:
    """A unit for a TcpHost around modules such as Wago464, which state their place in the image.

    modules: as register 0x2030 lists them: 464 for a 750-464, bit 15 set for digital modules
    """

    def __init__(self, image: Sequence[ModbusUnit], *, item: int = 352, modules: Sequence[int] = (464,)) -> None:
        self._image, self._item, self._modules = tuple(image), item, tuple(modules)

    @property
    def silent(self) -> bool:
        """A coupler answers for all its modules."""
        return any(module.silent for module in self._image)

    def memory(self, function: int) -> Mapping[int, int]:
        """Functions 3 and 4 both read the input image; the nameplate is read by either."""
        if function not in (3, 4):
            return {}
        words = {address: word for module in self._image for address, word in module.memory(4).items()}
        listed = (self._item, *self._modules, *[0] * (_MODULE_WORDS - 1 - len(self._modules)))
        return words | {_SERIES: 750, _SERIES + 1: self._item} | {_MODULES + i: w for i, w in enumerate(listed)}
