"""The attribute service of the emulated control: reads and writes its variables, subject to the users' rights."""

from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Protocol, cast

from asyncua import ua
from asyncua.common.callback import ServerItemCallback
from asyncua.crypto.permission_rules import User as Session
from asyncua.server.address_space import AddressSpace, AttributeService
from asyncua.server.server import Server
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.status_codes import StatusCodes
from asyncua.ua.uatypes import DateTime, Int16, NodeId, StatusCode, String, UInt32

from simulators.nc.access import NOBODY, Users
from simulators.nc.nck import R_STATE, R_VERSION, MachineState
from simulators.nc.variables import AccessRight, Value, Variable

_LISTED = tuple(f"/Channel/Parameter/R[u1,{number}]" for number in (R_STATE, R_VERSION))


class Kernel(Protocol):
    """The part of the control that the service needs."""

    @property
    def out_of_service(self) -> set[str]:
        """Names of nodes whose values the control reports as bad."""
        ...

    @property
    def write_protected(self) -> set[str]:
        """Names of nodes that nobody may write."""
        ...

    def now(self) -> float:
        """Simulated seconds, after everything that was due has been processed."""
        ...

    def utc(self) -> datetime: ...

    def state(self) -> MachineState:
        """The machine's state now."""
        ...

    def wake(self) -> None:
        """Called after a value was written: the next event may have changed."""
        ...


class Attributes(AttributeService):
    """Answers for the control's variables; the library's server answers for everything else."""

    def __init__(
        self, aspace: AddressSpace, namespace: int, table: Mapping[str, Variable], kernel: Kernel, users: Users
    ) -> None:
        super().__init__(aspace)
        self._namespace = namespace
        self._table = table
        self._kernel = kernel
        self._users = users
        self._reader = NOBODY

    def note_reader(self, event: ServerItemCallback, _: object) -> None:
        """The library reveals the reading user only here, just before `read`."""
        self._reader = event.user

    def _variable(self, node: NodeId, attribute: AttributeIds) -> Variable | None:
        if node.NamespaceIndex != self._namespace or attribute != AttributeIds.Value:
            return None
        return self._table.get(str(node.Identifier))

    def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        state = self._kernel.state()
        rights = self._users.rights(self._reader)
        time = cast(DateTime, self._kernel.utc())
        results = []
        for item in params.NodesToRead:
            variable = self._variable(item.NodeId, item.AttributeId)
            if variable is None:
                results.append(self._aspace.read_attribute_value(item.NodeId, item.AttributeId))
            elif variable.readable_with not in rights:
                results.append(ua.DataValue(StatusCode=StatusCode(UInt32(StatusCodes.BadUserAccessDenied))))
            else:
                status = _status(self._kernel, str(item.NodeId.Identifier))
                results.append(ua.DataValue(_variant(variable.read(state)), status, time))
        return results

    async def write(self, params: ua.WriteParameters, user: Session = NOBODY) -> list[StatusCode]:
        results = []
        rights = self._users.rights(user)
        for item in params.NodesToWrite:
            variable = self._variable(item.NodeId, item.AttributeId)
            if variable is None:
                results += await super().write(ua.WriteParameters(NodesToWrite=[item]), user)
            else:
                protected = str(item.NodeId.Identifier) in self._kernel.write_protected
                allowed = frozenset() if protected else rights
                results.append(StatusCode(UInt32(self._write(variable, item.Value, allowed))))
        self._kernel.wake()
        return results

    def _write(self, variable: Variable, value: ua.DataValue, rights: frozenset[AccessRight]) -> int:
        if variable.write is None:
            return int(StatusCodes.BadNotWritable)
        if variable.writable_with not in rights:
            return int(StatusCodes.BadUserAccessDenied)
        if value.Value is None or value.Value.VariantType is not ua.VariantType.Double:
            return int(StatusCodes.BadTypeMismatch)
        variable.write(value.Value.Value, self._kernel.now())
        return int(StatusCodes.Good)


def _status(kernel: Kernel, path: str) -> StatusCode:
    bad = path in kernel.out_of_service
    return StatusCode(UInt32(StatusCodes.BadOutOfService if bad else StatusCodes.Good))


def _variant(value: Value) -> ua.Variant:
    match value:
        case bool():
            return ua.Variant(value, ua.VariantType.Boolean)
        case int():
            return ua.Variant(value, ua.VariantType.UInt32)
        case _:
            return ua.Variant(float(value), ua.VariantType.Double)


async def add_nodes(server: Server, index: int, table: Mapping[str, Variable], kernel: Kernel) -> None:
    """The variables as nodes, so that clients can browse and monitor them.

    R-parameters are omitted, except for the probing state and the version of its programs: like a real control, this
    one answers for names that it does not list.
    """

    def value_of(path: str, variable: Variable) -> Callable[[NodeId, AttributeIds], ua.DataValue]:
        return lambda _node, _attribute: ua.DataValue(_variant(variable.read(kernel.state())), _status(kernel, path))

    folder = await server.nodes.objects.add_folder(_node_id("/Sinumerik", index), "Sinumerik")
    for path, variable in table.items():
        if path.startswith("/Channel/Parameter/R[") and path not in _LISTED:
            continue
        node = await folder.add_variable(_node_id(path, index), path, 0.0)
        server.set_attribute_value_callback(node.nodeid, value_of(path, variable))


def _node_id(path: str, index: int) -> NodeId:
    return NodeId(String(path), Int16(index))
