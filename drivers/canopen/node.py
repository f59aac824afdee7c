"""Reads objects of a CANopen node by SDO, by TPDOs after SYNC, or by TPDOs that it sends on its timer.

What was checked at connect holds for one start of the node: after a restart or a silence it is checked again.
"""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from time import monotonic

from drivers.base import BadAnswer, DriverError, NoAnswer, Quality, Refused, WrongDevice
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.events import HeartbeatWatch
from drivers.canopen.pdo import COMMUNICATION, EVERY_SYNC, MAPPING, ON_EVENTS, TPDOS, PdoMap, pdo_map
from drivers.canopen.place import CanObject
from drivers.canopen.settings import NodeOptions
from drivers.faults import Fault
from drivers.text import Text

PRODUCER_TIME = 0x1017
_PRODUCER_TIMES = 3
"""Heartbeats or timed TPDOs in a row until a node counts as lost: a busy bus may drop one, but not three."""
_DEVICE_TYPE = CanObject(0x1000, 0)
_SERIAL_NUMBER = CanObject(0x1018, 4)
_DOUBLED_S = 10.0
"""How long two nodes with one id are remembered after both were last heard."""
_NO_HEARTBEAT = Fault(Quality.STALE, Text("canopen_heartbeat_stopped"))


class NodeReader:
    """The objects of one node, all from one start of it.

    Parameters
    ----------
    asked: objects to read by SDO, in this order; one may occur several times
    each: whether an object that the node refuses or answers badly is left out, instead of failing the read
    check: raises WrongDevice if the node is not what the profile says; called before the first read, and again after a
        restart or a silence
    identify: the part of `check` that is repeated where the node left one request unanswered and others not
    """

    def __init__(
        self,
        bus: CanOpenBus,
        device: str,
        node: int,
        options: NodeOptions,
        asked: Sequence[CanObject],
        check: Callable[[], Awaitable[None]],
        *,
        each: bool = False,
        identify: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        self._bus, self._device, self._node, self._check, self._each = bus, device, node, check, each
        self._identify = identify or check
        self.lost: dict[CanObject, DriverError] = {}
        """Why objects were left out of the latest read."""
        self._came_s: dict[CanObject, float] = {}
        """When each object of the latest read came in its TPDO, monotonic s; empty with SDO."""
        self.ask(asked)
        bus.let_rest(node, options.rest_ms / 1e3)
        self._heartbeat_s, self._transfer = options.heartbeat_s, options.transfer
        self._heartbeat = HeartbeatWatch(bus.events(node))
        self._ready = False
        self._missed = False
        """Whether it left a request unanswered and others not: it is still set up, and identified before the next
        read."""
        self._boots = 0
        self._maps: tuple[PdoMap, ...] = ()
        self._started_s = 0.0
        self._read_s = -inf
        """When the latest read began."""
        self._before_s = -inf
        """When the one before it did."""
        self._has_serial_number = True
        self._asked_early_s = -inf
        """When the node was last asked for what came too early."""

    def ask(self, objects: Sequence[CanObject]) -> None:
        """Read these objects from now on."""
        self._asked, self._wanted = tuple(objects), tuple(dict.fromkeys(objects))

    async def connect(self) -> None:
        """Check the node, its heartbeat and its TPDOs. Raises WrongDevice, or the bus's errors."""
        self._ready = False
        boots = self._bus.events(self._node).boots
        await self._check()
        await self._hear_both()
        limit_s, producer_s = await self._heartbeat_limit_s()
        if self._transfer != "sdo":
            self._maps = await self._pdo_maps()
            self._started_s = monotonic()
            every_s = {pdo.identifier: pdo.event_s for pdo in self._maps}
            await self._bus.start_node(self._device, self._node, every_s)
        self._ready, self._boots = True, boots
        if not limit_s:
            self._bus.unwatched(self._node, 0.0)
        demanded = self._heartbeat_s > 0
        self._heartbeat.begin(limit_s, monotonic(), demanded=demanded, producer_s=producer_s)

    async def read(self) -> dict[CanObject, list[bytes]]:
        """Each object as many times as it was asked for, or once from a TPDO; those in `lost` are left out.

        A node that restarts between two of our requests may be a different one or have a different set-up: what it sent
        in this read is discarded, and read again after the checks. Raises BadAnswer, or the bus's errors.
        """
        self._before_s, self._read_s = self._read_s, monotonic()
        objects = await self._of_one_start() or await self._of_one_start()
        if objects is None:
            self._ready = False
            raise BadAnswer(
                Text("canopen_restarted", node=self._node),
                bus=self._bus.name,
                device=self._device,
                hint=Text("check_supply"),
            )
        return objects

    @property
    def doubt(self) -> Fault | None:
        """Why no value of the latest read can be used: two nodes have one id, or the node answers although its
        heartbeat has stopped, and may repeat its last measurement."""
        now_s = monotonic()
        synchronous = [pdo.identifier for pdo in self._maps] if self._transfer == "sync" else []
        doubled_s, how = self._bus.doubled(self._node, synchronous)
        if doubled_s >= min(max(0.0, self._before_s), now_s - _DOUBLED_S):
            what = Text("canopen_two_nodes", node=self._node, how=how)
            return Fault(Quality.COMM_FAULT, what)
        if self._heartbeat.doubled:
            return Fault(Quality.COMM_FAULT, Text("canopen_heartbeats_doubled", node=self._node))
        if (stated_s := self._heartbeat.never_came_s(now_s)) > 0:
            self._bus.unwatched(self._node, stated_s)
        return _NO_HEARTBEAT if self._heartbeat.silent_s(now_s) is not None else None

    def ages_s(self, channels: Mapping[str, Sequence[CanObject]]) -> dict[str, float]:
        """By channel, the time since the oldest of its objects in the latest read came; 0 for those that were asked
        for."""
        now_s, came_s = monotonic(), self._came_s
        return {name: max(now_s - came_s.get(place, now_s) for place in places) for name, places in channels.items()}

    def forget(self) -> None:
        """Check the node again before the next read."""
        self._ready = False

    async def upload(self, *objects: CanObject) -> list[bytes]:
        """Read these objects by SDO. Raises the bus's errors."""
        return await self._bus.upload(self._device, self._node, objects)

    async def upload_each(self, objects: Sequence[CanObject]) -> dict[CanObject, list[bytes]]:
        """Read these by SDO, and note in `lost` which cannot be read. Raises that error if none can."""
        read: dict[CanObject, list[bytes]] = {}
        self.lost = {}
        for wanted, data in zip(objects, await self._bus.upload_each(self._device, self._node, objects), strict=True):
            if isinstance(data, DriverError):
                self.lost[wanted] = data
            else:
                read.setdefault(wanted, []).append(data)
        if not read and self.lost:
            raise next(iter(self.lost.values()))
        return read

    def wrong(self, what: str, channel: str = "", hint: str = "") -> WrongDevice:
        """The error of a node that is not what the profile says."""
        return WrongDevice(what, bus=self._bus.name, device=self._device, channel=channel, hint=hint)

    async def _of_one_start(self) -> dict[CanObject, list[bytes]] | None:
        """The node's answers after it was checked; None if it has restarted meanwhile."""
        events = self._bus.events(self._node)
        if not self._ready or self._boots != events.boots:
            await self.connect()
        elif self._missed:
            await self._identify()
        self._missed = False
        try:
            objects = await self._objects()
        except DriverError as error:
            self._missed = error.heard
            if not (error.hurried or error.heard):
                self._ready = False
            raise
        # The boot-up message precedes everything else from the node, and the receiving thread keeps the order.
        return objects if self._boots == events.boots else None

    async def _hear_both(self) -> None:
        """Ask for the serial number, which two nodes with this id answer differently."""
        if self._has_serial_number:
            try:
                await self.upload(_SERIAL_NUMBER)
            except (NoAnswer, BadAnswer, Refused):  # it is optional
                self._has_serial_number = False

    async def _ask_early_ones(self) -> None:
        """A TPDO that comes sooner than its timer sends it may be sent on an event, or by a second node with this id:
        both nodes answer when they are asked for what is in it, the second one while something else is asked for."""
        early = [m for m in self._maps if self._bus.early_s([m.identifier]) > self._asked_early_s]
        now_s = monotonic()
        if not early or now_s - self._asked_early_s < _DOUBLED_S / 2:
            return
        self._asked_early_s = now_s
        objects = [place for pdo in early for place in self._wanted if place in pdo.places]
        await self._bus.upload_each(self._device, self._node, [*objects, _DEVICE_TYPE])

    async def _heartbeat_limit_s(self) -> tuple[float, float]:
        """Consumer time, s, 0 if no heartbeat is expected, and the time that the node states.

        Raises WrongDevice when the node's heartbeat is too slow.
        """
        try:
            (producer,) = await self.upload(CanObject(PRODUCER_TIME, 0))
        except Refused:  # the object is optional when the node uses node guarding
            producer = b""
        producer_s = int.from_bytes(producer[:2], "little") / 1000
        if self._heartbeat_s and not 0 < producer_s < self._heartbeat_s:
            sends = Text("canopen_every_s", s=producer_s) if producer_s else Text("never")
            raise self.wrong(
                Text("canopen_heartbeat", node=self._node, sends=sends, wanted_s=self._heartbeat_s),
                hint=Text("canopen_set_heartbeat"),
            )
        return self._heartbeat_s or _PRODUCER_TIMES * producer_s, producer_s

    async def _objects(self) -> dict[CanObject, list[bytes]]:
        """Every object, as many times as it was read."""
        if self._transfer == "sdo" and self._each:
            return await self.upload_each(self._asked)
        if self._transfer == "sdo":
            read: dict[CanObject, list[bytes]] = {}
            for asked, data in zip(self._asked, await self.upload(*self._asked), strict=True):
                read.setdefault(asked, []).append(data)
            return read
        identifiers = [pdo.identifier for pdo in self._maps]
        if self._transfer == "sync":
            frames = await self._bus.synchronise(self._device, self._node, identifiers)
        else:
            # Frames from before the check may be those of another node, or have another mapping.
            interval_s, now_s = max(pdo.event_s for pdo in self._maps), monotonic()
            oldest_s = max(self._started_s, now_s - _PRODUCER_TIMES * interval_s)
            # One more interval, so that no node counts as lost on a computer that was briefly busy.
            until_s = max(self._started_s + self._bus.timeout_s, now_s + interval_s)
            frames = await self._bus.latest(self._device, self._node, identifiers, oldest_s, until_s)
            await self._ask_early_ones()
        objects: dict[CanObject, list[bytes]] = {}
        self._came_s = {}
        for pdo in self._maps:
            frame = frames[pdo.identifier]
            for place, data in pdo.decode(frame.data).items():
                objects[place], self._came_s[place] = [data], frame.came_s
        lost: dict[CanObject, DriverError] = {
            wanted: BadAnswer(
                Text("canopen_tpdo_short", wanted=str(wanted)),
                bus=self._bus.name,
                device=self._device,
            )
            for wanted in self._wanted
            if wanted not in objects
        }
        if lost and (not self._each or len(lost) == len(self._wanted)):
            raise next(iter(lost.values()))
        self.lost = lost
        return objects

    async def _pdo_maps(self) -> tuple[PdoMap, ...]:
        """The TPDOs that hold the wanted objects, each transmitted as the transfer requires. Raises WrongDevice."""
        found: list[PdoMap] = []
        for number in range(TPDOS):
            description = [
                CanObject(COMMUNICATION + number, 1),
                CanObject(COMMUNICATION + number, 2),
                CanObject(MAPPING + number, 0),
            ]
            try:
                cob_id, kind, count = await self.upload(*description)
                entries = await self.upload(*(CanObject(MAPPING + number, i + 1) for i in range(min(count[0], 64))))
            except (BadAnswer, Refused):  # the node has no such TPDO
                continue
            pdo = pdo_map(int.from_bytes(cob_id, "little"), [int.from_bytes(entry, "little") for entry in entries])
            if pdo is not None and any(wanted in pdo.places for wanted in self._wanted):
                found.append(await self._timed(number, kind[0], pdo))
        for wanted in self._wanted:
            if not any(wanted in pdo.places for pdo in found):
                raise self.wrong(Text("canopen_not_mapped", wanted=str(wanted)), hint=Text("canopen_map_it"))
        return tuple(found)

    async def _timed(self, number: int, kind: int, pdo: PdoMap) -> PdoMap:
        """The TPDO with its event timer. Raises WrongDevice when it is not transmitted as the transfer requires."""
        right = (EVERY_SYNC,) if self._transfer == "sync" else ON_EVENTS
        if kind not in right:
            raise self.wrong(
                Text("canopen_transmission", number=number + 1, kind=kind, right=right[-1]),
                hint=Text("canopen_set_transmission", object=COMMUNICATION + number, right=right[-1]),
            )
        if self._transfer == "sync":
            return pdo
        timer = CanObject(COMMUNICATION + number, 5)
        try:
            (interval,) = await self.upload(timer)
        except Refused:  # the object is optional
            interval = b""
        event_s = int.from_bytes(interval[:2], "little") / 1000
        if not 0 < event_s < self._bus.timeout_s:
            sends = Text("canopen_sent_every_s", s=event_s) if event_s else Text("canopen_never_sent")
            raise self.wrong(
                Text("canopen_tpdo_slow", number=number + 1, sends=sends, timeout_s=self._bus.timeout_s),
                hint=Text("canopen_set_timer", timer=str(timer)),
            )
        return replace(pdo, event_s=event_s)
