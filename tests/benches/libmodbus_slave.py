"""A Modbus slave made with libmodbus (Debian package libmodbus5); libmodbus_line runs it as a process.

Usage: libmodbus_slave.py tcp          prints its port
       libmodbus_slave.py rtu PATH     unit 3, 19200 8N1; prints "ready"
"""

import ctypes
import socket
import sys

UNIT = 3
LONGEST = 260


class Mapping(ctypes.Structure):
    """modbus_mapping_t of modbus.h."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("nb_bits", "start_bits", "nb_input_bits", "start_input_bits")),
        *((name, ctypes.c_int) for name in ("nb_input_registers", "start_input_registers")),
        *((name, ctypes.c_int) for name in ("nb_registers", "start_registers")),
        ("tab_bits", ctypes.POINTER(ctypes.c_uint8)),
        ("tab_input_bits", ctypes.POINTER(ctypes.c_uint8)),
        ("tab_input_registers", ctypes.POINTER(ctypes.c_uint16)),
        ("tab_registers", ctypes.POINTER(ctypes.c_uint16)),
    )


def main() -> None:
    modbus = ctypes.CDLL("libmodbus.so.5")
    modbus.modbus_new_tcp.restype = modbus.modbus_new_rtu.restype = ctypes.c_void_p
    modbus.modbus_mapping_new.restype = ctypes.POINTER(Mapping)
    mapping = modbus.modbus_mapping_new(269, 0x0311, 262, 6)
    image = mapping.contents
    for i, word in enumerate((200, 213, 0xFFDF, 400, 0x7FFF, 222)):  # an M-7015, input 4 broken
        image.tab_input_registers[i] = word
        image.tab_registers[256 + i] = 0x2E
    image.tab_input_bits[128 + 4] = 1
    image.tab_input_bits[0x0300] = image.tab_input_bits[0x0310] = 1
    image.tab_bits[268] = 1
    for i, word in enumerate((0x8000, 0x4000, 0xC000, 1, 0xFFFE, 0xFFFF, 0x8000)):  # an ADAM-6015, input 6 burnt out
        image.tab_registers[i] = word
        image.tab_registers[200 + i] = 0x03A4
    image.tab_bits[120 + 6] = 1

    query = (ctypes.c_uint8 * LONGEST)()
    if sys.argv[1] == "rtu":
        context = ctypes.c_void_p(modbus.modbus_new_rtu(sys.argv[2].encode(), 19200, ctypes.c_char(b"N"), 8, 1))
        modbus.modbus_set_slave(context, UNIT)
        if modbus.modbus_connect(context) != 0:
            sys.exit("cannot open the port")
        print("ready", flush=True)
        while True:
            if (length := modbus.modbus_receive(context, query)) > 0:
                modbus.modbus_reply(context, query, length, mapping)
    context = ctypes.c_void_p(modbus.modbus_new_tcp(b"127.0.0.1", 0))
    listener = ctypes.c_int(modbus.modbus_tcp_listen(context, 1))
    print(_port(listener.value), flush=True)
    while True:
        modbus.modbus_tcp_accept(context, ctypes.byref(listener))
        while (length := modbus.modbus_receive(context, query)) >= 0:
            modbus.modbus_reply(context, query, length, mapping)


def _port(descriptor: int) -> int:
    listener = socket.socket(fileno=descriptor)
    port: int = listener.getsockname()[1]
    listener.detach()
    return port


if __name__ == "__main__":
    main()
