"""A CAN bus with CANopen nodes. Interfaces block, so they are used in threads that this bus owns and joins: while
connected one receives and one asks.

The canopen library sends and distributes the frames. Its SDO client is not used: it gives up at a late answer.
"""

import asyncio
import logging
import math
import queue
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from time import monotonic, sleep
from typing import Any, TypeVar

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused
from drivers.can.bus import KeptFrame
from drivers.can.interface import interface_error, open_interface, shut
from drivers.can.receiver import Receiver
from drivers.canopen.events import NodeEvents
from drivers.canopen.frames import LatestFrames, SdoAnswers, pass_on
from drivers.canopen.place import ABORT, BEGINS, KIND, TOGGLE, CanObject, Segment
from drivers.canopen.settings import CanOpenSettings
from drivers.patience import Patience
from drivers.requests import Requests
from drivers.rests import Rests
from drivers.tap import Tap
from drivers.text import Text

R = TypeVar("R")

_SYNC = 0x080
_AT_ONCE, _COUNTED, _LAST = 0x02, 0x01, 0x01
"""Bits of the first byte of an SDO answer: all of the number is in this frame; it says how many bytes it has; it is the
last segment."""
_NMT_START = 1
_DEVICE_TYPE = CanObject(0x1000, 0)
_SHORTEST_S = 0.01
"""A request that must be answered sooner than this is not sent."""
_NO_OBJECT = bytes((ABORT, 0, 0, 0))
"""Of an abort that does not say to which request it is the answer."""
_RESTS_S = (0.0, 0.002, 0.01, 0.05, 0.1, 0.2)
"""Rests after an answer that are tried one after the other."""
_LONGEST_NUMBER = 8
"""Bytes of the widest number that a node may hold. A transfer that never ends is aborted beyond that."""


logging.getLogger("canopen").setLevel(logging.CRITICAL)  # what it logs is raised here as an error


class Uncounted(bytes):
    """Four bytes of which the node does not say how many count: as many as the object's type has (CiA 301)."""


class CanOpenBus:
    """Nodes on one CAN interface. Requests to all nodes queue for one thread, which leads each by SDO through its life
    (`Requests`), as a Modbus bus does."""

    kind = CanOpenSettings.bus_kind
    units = CanOpenSettings.units

    def __init__(self, name: str, settings: CanOpenSettings, tap: Tap | None = None) -> None:
        self.name, self.timeout_s = name, settings.timeout_s
        self._settings, self._tap = settings, tap
        self._network: Any = None
        self._thread: ThreadPoolExecutor | None = None
        self._patience = Patience(settings.timeout_s)
        self._until_s = math.inf
        self._requests = Requests[CanObject](numbered=False, copied=False)
        self._doubtful: set[int] = set()
        """Nodes of which frames after an earlier SYNC may still come."""
        self._events: dict[int, NodeEvents] = {}
        self._unwatched: dict[int, Text] = {}
        self._rests = Rests(steps_s=_RESTS_S)
        self._heard: dict[int, SdoAnswers] = {}
        self._frames = LatestFrames()
        self._sent_s = 0.0
        """When the latest request by SDO was sent."""
        self._other = b""
        """The last answer since then that did not fit; empty if there was none."""
        self._synchronised_s = 0.0
        """When the last SYNC was sent."""
        self._taken_s: dict[int, float] = {}
        """When the SYNC was sent that each node has answered, or when it was started: later ones serve it."""

    async def connect(self) -> None:
        """Open the interface, unless it is already open. Raises ConnectError."""
        if self._thread is not None:
            if self._network is not None and self._network.notifier.exception is None:
                return
            await self.close()
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=f"canopen {self.name}")
        try:
            await self._in_thread(self._open)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        if self._thread is None:
            return
        thread, self._thread = self._thread, None
        try:
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(thread, self._shut))
        except asyncio.CancelledError:
            thread.shutdown(wait=False)  # it ends as soon as the interface is closed
            raise
        thread.shutdown(wait=True)

    async def upload(
        self, device: str, node: int, objects: Sequence[CanObject], most_bytes: int = _LONGEST_NUMBER
    ) -> list[bytes]:
        """Read objects of one node by SDO, each as little-endian bytes; one longer than `most_bytes` raises BadAnswer.

        Raises NoAnswer, BadAnswer, Refused (SDO abort) or ConnectError (interface lost).
        """
        return await self._in_thread(lambda: self._upload(device, node, objects, most_bytes))

    async def upload_each(
        self, device: str, node: int, objects: Sequence[CanObject]
    ) -> list[bytes | BadAnswer | Refused]:
        """As `upload`, but with the error of each object that is refused or badly answered in its place."""

        def each(wanted: CanObject) -> bytes | BadAnswer | Refused:
            try:
                return self._upload(device, node, (wanted,))[0]
            except (BadAnswer, Refused) as error:
                return error

        return await self._in_thread(lambda: [each(wanted) for wanted in objects])

    async def start_node(self, device: str, node: int, every_s: Mapping[int, float]) -> None:
        """Make the node operational (NMT), and keep these TPDOs from the first one on. Raises ConnectError.

        every_s: how often each of them is sent on its timer; 0: it is not
        """

        def start() -> None:
            self._frames.timed(every_s)
            self._listen(device, tuple(every_s))
            self._send(device, 0, bytes((_NMT_START, node)))
            self._taken_s[node] = monotonic()

        await self._in_thread(start)

    async def synchronise(self, device: str, node: int, identifiers: Sequence[int]) -> dict[int, KeptFrame]:
        """Send SYNC and wait for these TPDOs of the node. Raises NoAnswer or ConnectError."""
        return await self._in_thread(lambda: self._synchronise(device, node, identifiers))

    async def latest(
        self, device: str, node: int, identifiers: Sequence[int], oldest_s: float, until_s: float
    ) -> dict[int, KeptFrame]:
        """The node's latest TPDOs, none older than `oldest_s`. Waits until `until_s` for missing ones.

        Both times are monotonic seconds. Raises NoAnswer or ConnectError.
        """
        return await self._in_thread(
            lambda: self._await_frames(device, node, identifiers, oldest_s, until_s, Text("canopen_not_on_timer"))
        )

    def learnt(self) -> Collection[Text]:
        """The nodes of which nothing says that their firmware still runs, and those that need a rest."""
        rests = self._rests.needed_s.items()
        return [
            *self._unwatched.values(),
            *(Text("needs_rest", bus=self.name, unit=node, rest_ms=round(1e3 * rest_s)) for node, rest_s in rests),
        ]

    def answers_s(self) -> Mapping[int, float]:
        return self._patience.usual_s()

    def let_rest(self, node: int, least_s: float) -> None:
        """The node is never asked sooner than this after an answer."""
        self._rests.state(node, least_s)

    def unwatched(self, node: int, producer_s: float) -> None:
        """No heartbeat of the node is expected, or none has ever come; producer_s: as it states, 0: it sends none."""
        code = "canopen_never_beats" if producer_s else "canopen_no_heartbeat"
        self._unwatched.setdefault(
            node, Text(code, bus=self.name, node=node, **({"s": producer_s} if producer_s else {}))
        )

    def events(self, node: int) -> NodeEvents:
        """Events that the node has sent since its first upload on this connection."""
        return self._events.setdefault(node, NodeEvents())

    def doubled(self, node: int, identifiers: Iterable[int]) -> tuple[float, str]:
        """When two different answers of the node last came where one was due, monotonic, and how, in words.

        identifiers: its TPDOs that are sent after SYNC
        """
        answers = self._heard.get(node)
        frames_s = self._frames.doubled_s(identifiers)
        by_sdo = (-math.inf, "") if answers is None else answers.doubled
        return max(by_sdo, (frames_s, Text("canopen_sync_doubled")))

    def early_s(self, identifiers: Iterable[int]) -> float:
        """When one of these TPDOs last came sooner than its timer sends it, with other data, monotonic."""
        return self._frames.early_s(identifiers)

    @property
    def _hears_itself(self) -> bool:
        return self._settings.interface == "udp_multicast"

    async def _in_thread(self, work: Callable[[], R]) -> R:
        """Run in the bus's thread. Cancelling the caller does not stop the work, so no answer is left unread."""
        if self._thread is None:
            raise ConnectError(Text("not_connected"), bus=self.name, hint=Text("connect_bus_first"))
        future = asyncio.get_running_loop().run_in_executor(self._thread, work)
        future.add_done_callback(lambda done: done.cancelled() or done.exception())
        return await asyncio.shield(future)

    def _open(self) -> None:
        interface = open_interface(self.name, self._settings, tap=self._tap)
        network = canopen.Network(interface)
        network.unsubscribe(network.lss.LSS_RX_COBID)  # it would collect these frames without limit
        # Replaces `connect`, whose python-can notifier waits by the wall clock. Before it sends, the library asks this
        # receiver for the exception that ended it.
        network.notifier = Receiver(interface, partial(pass_on, network))  # type: ignore[assignment]
        self._network = network
        self._doubtful.clear()
        self._heard.clear()
        self._requests.clear()
        self._taken_s.clear()
        self._frames = LatestFrames()
        if not self._hears_itself:
            network.subscribe(_SYNC, self._frames.synchronised)

    def _shut(self) -> None:
        network, self._network = self._network, None
        if network is not None:
            network.notifier.stop()
            shut(network.bus)

    def _upload(
        self, device: str, node: int, objects: Sequence[CanObject], most_bytes: int = _LONGEST_NUMBER
    ) -> list[bytes]:
        if self._network is None:
            raise ConnectError(Text("not_connected"), bus=self.name, device=device)
        if node not in self._heard:
            answers = self._heard[node] = SdoAnswers()
            self._network.subscribe(0x580 + node, answers.put)
            if not self._hears_itself:
                self._network.subscribe(0x600 + node, answers.other_asked)
            self._network.subscribe(0x80 + node, self.events(node).on_emergency)
            self._network.subscribe(0x700 + node, self.events(node).on_heartbeat)
        return [self._one(device, node, wanted, most_bytes) for wanted in objects]

    def _settle(self, device: str, node: int, wanted: CanObject) -> None:
        """Ask for an object that is never a value where an earlier answer may be taken for that to this request. A node
        answers in order: once that is answered, nothing older follows."""
        requests = self._requests
        if requests.separator(node, wanted) is None:
            return
        other, wait_s = requests.another(node, wanted), self._longest_s(node)
        is_asked = requests.expects(node, other)  # then the answer to the earlier request will do
        self._send_request(device, node, other)
        try:
            while requests.took(node, other) is None and not (is_asked and requests.separator(node, wanted) is None):
                self._hear(node, self._sent_s + wait_s)
        except queue.Empty:
            raise self._unanswered(device, node, other, wait_s) from None
        self._rests.answered(node, monotonic())
        self._heard[node].settled()

    def _asked(self, device: str, node: int, wanted: CanObject, wait_s: float) -> bytes:
        """The answer to this request. Raises NoAnswer, BadAnswer or Refused."""
        self._send_request(device, node, wanted)
        try:
            while (came := self._requests.took(node, wanted)) is None:
                self._hear(node, self._sent_s + wait_s)
        except queue.Empty:
            raise self._unanswered(device, node, wanted, wait_s) from None
        self._rests.answered(node, monotonic())
        self._requests.was_heard(node)
        if came.message[0] & KIND == ABORT:
            error = SdoAbortedError(int.from_bytes(came.message[4:], "little"))
            what = Text("canopen_refused", node=node, wanted=str(wanted), error=str(error))
            raise Refused(what, bus=self.name, device=device, hint=Text("profile_fits"))
        return came.message

    def _send_request(self, device: str, node: int, wanted: CanObject) -> None:
        self._let_rest(device, node)
        self._listen_to(node)
        if not isinstance(wanted, Segment):
            self._heard[node].expect(wanted)
        self._sent_s = monotonic()
        self._requests.sent(node, wanted, self._sent_s)
        self._send(device, 0x600 + node, wanted.request)

    def _listen_to(self, node: int) -> None:
        """Hear what has come of it since it was asked last."""
        with suppress(queue.Empty):
            while True:
                self._hear(node, -math.inf)
        self._other = b""

    def _hear(self, node: int, until_s: float) -> None:
        """Give its next answer to the request that it fits. Raises queue.Empty."""
        came_s, answer = self._heard[node].get(until_s)
        is_unclear = answer[:4] == _NO_OBJECT and sum(unit == node for unit, _ in self._requests.due()) > 1
        if is_unclear or not self._requests.came(node, answer, came_s):
            self._other = answer

    def _let_rest(self, device: str, node: int) -> None:
        """Wait for as long as the node needs after its last answer, if time is left to ask it then."""
        rest_s = max(0.0, self._rests.left_s(node, monotonic(), first=math.isinf(self._until_s)))
        if self._until_s - monotonic() - rest_s < _SHORTEST_S:
            what = Text("canopen_no_time", node=node)
            raise NoAnswer(what, hurried=True, heard=True, bus=self.name, device=device)
        sleep(rest_s)
        self._rests.sent(node, monotonic())

    def _synchronise(self, device: str, node: int, identifiers: Sequence[int]) -> dict[int, KeptFrame]:
        """Every node answers each SYNC, whichever it was sent for. One that was sent just before, after the node's last
        read, serves it too: a second one might overtake frames of the first, and the status of one moment would pass
        for that of another."""
        last_s, taken_s = self._synchronised_s, self._taken_s.get(node, math.inf)
        if node not in self._taken_s or taken_s < last_s < monotonic() - self._settings.timeout_s:
            self._doubtful.add(node)
        if node in self._doubtful:
            self._flush(device, node)
            taken_s = math.inf  # only its own SYNC serves it
        self._listen(device, identifiers)
        self._frames.synchronous(identifiers)
        if taken_s >= last_s:
            # A node that has not taken the SYNC before may still send its frames, and is asked for something else
            # first.
            self._taken_s = {other: s for other, s in self._taken_s.items() if s >= last_s}
            sent_s = monotonic()
            self._frames.synchronised()
            self._send(device, _SYNC, b"")
            self._synchronised_s = sent_s
        asked_s, wait_s = self._synchronised_s, self._patience.wait_s(node, _SYNC)
        failing, hurried = Text("canopen_not_after_sync"), wait_s < self._settings.timeout_s
        found = self._await_frames(device, node, identifiers, asked_s, asked_s + wait_s, failing, hurried=hurried)
        self._patience.answered(node, _SYNC, max(frame.came_s for frame in found.values()) - asked_s)
        self._taken_s[node] = asked_s
        return found

    def _flush(self, device: str, node: int) -> None:
        """Ask for what every node has: frames after an earlier SYNC come before its answer."""
        with suppress(Refused):
            self._upload(device, node, [_DEVICE_TYPE])
        self._doubtful.discard(node)

    def _listen(self, device: str, identifiers: Sequence[int]) -> None:
        if self._network is None:
            raise ConnectError(Text("not_connected"), bus=self.name, device=device)
        for identifier in identifiers:
            self._network.subscribe(identifier, self._frames.put)

    def _await_frames(
        self,
        device: str,
        node: int,
        identifiers: Sequence[int],
        oldest_s: float,
        until_s: float,
        failing: str,
        *,
        hurried: bool = False,
    ) -> dict[int, KeptFrame]:
        self._listen(device, identifiers)
        found = self._frames.since(oldest_s, identifiers, until_s)
        if missing := sorted(set(identifiers) - set(found)):
            listed = ", ".join(f"0x{identifier:03X}" for identifier in missing)
            raise self._silence(
                device,
                node,
                Text("canopen_tpdo_failing", listed=listed, failing=failing),
                until_s - oldest_s,
                hurried=hurried,
            )
        return found

    def _send(self, device: str, identifier: int, data: bytes) -> None:
        if self._network is None:
            raise ConnectError(Text("not_connected"), bus=self.name, device=device)
        try:
            self._network.send_message(identifier, data)
        except (can.CanError, OSError) as error:
            raise interface_error(self.name, device, self._settings, error) from error

    def _one(self, device: str, node: int, wanted: CanObject, most_bytes: int) -> bytes:
        self._listen_to(node)
        self._requests.begin(node, monotonic())
        self._settle(device, node, wanted)
        longest_s = self._longest_s(node)
        is_slow = longest_s > self._settings.timeout_s
        usual_s = self._patience.wait_s(node, wanted, loses=self._requests.loses(node))
        wait_s = longest_s if is_slow else min(longest_s, usual_s)
        asked_s = monotonic()
        answer = self._asked(device, node, wanted, wait_s)
        kind = answer[0]
        if kind & KIND != BEGINS:
            raise self._not_an_answer(device, node, wanted, answer)
        if kind & _AT_ONCE:
            data = answer[4 : 8 - (kind >> 2 & 3)] if kind & _COUNTED else Uncounted(answer[4:])
        else:
            data = self._segments(device, node, wanted, most_bytes, wait_s)
            size = int.from_bytes(answer[4:], "little") if kind & _COUNTED else 0
            if 0 < len(data) <= most_bytes and len(data) != (size or len(data)):
                what = Text("canopen_sent", node=node, count=len(data), wanted=str(wanted), size=size)
                raise BadAnswer(what, bus=self.name, device=device)
        if not 0 < len(data) <= most_bytes:
            told = Text("more_bytes", most=most_bytes) if data else Text("canopen_nothing")
            what = Text("canopen_holds", node=node, wanted=str(wanted), size=told)
            raise BadAnswer(what, bus=self.name, device=device)
        self._patience.answered(node, wanted, monotonic() - asked_s)
        return data

    def _segments(self, device: str, node: int, wanted: CanObject, most_bytes: int, wait_s: float) -> bytes:
        """All of a long number; of one that is longer than `most_bytes` not all."""
        data, toggle, is_last = b"", 0, False
        while not is_last and len(data) <= most_bytes:
            answer = self._asked(device, node, Segment(wanted.index, wanted.subindex, toggle), wait_s)
            part = answer[1 : 8 - (answer[0] >> 1 & 7)]
            data, toggle, is_last = data + part, toggle ^ TOGGLE, not part or bool(answer[0] & _LAST)
        if not is_last:
            self._end_transfer(device, node, wanted)
        return data

    def _end_transfer(self, device: str, node: int, wanted: CanObject) -> None:
        self._send(device, 0x600 + node, bytes((ABORT,)) + wanted.address + bytes(4))

    def limit(self, left_s: float) -> None:
        self._until_s = monotonic() + left_s

    def _longest_s(self, node: int) -> float:
        """How long an answer may take: longer than the timeout, if that is not enough and no other node waits; when all
        have been asked, as long as is left."""
        timeout_s, late_s = self._settings.timeout_s, self._requests.patience_s(node)
        left_s = self._until_s - monotonic()
        if math.isfinite(left_s):
            return max(0.0, min(max(timeout_s, late_s), left_s))
        return timeout_s if self._rests.are_several else self._patience.late_s(late_s)

    def _unanswered(self, device: str, node: int, wanted: CanObject, waited_s: float) -> DriverError:
        now_s, timeout_s = monotonic(), self._settings.timeout_s
        self._requests.missed(node, wanted)
        if isinstance(wanted, Segment):
            self._end_transfer(device, node, wanted)
        if not self._requests.is_late(node):
            self._rests.missed(node, now_s)
        others = self._rests.answered_s(node) >= now_s - waited_s - timeout_s
        silence = self._silence(device, node, Text("no_answer"), waited_s, hurried=waited_s < timeout_s, others=others)
        is_odd = self._other and isinstance(silence, NoAnswer)
        return self._not_an_answer(device, node, wanted, self._other) if is_odd else silence

    def _not_an_answer(self, device: str, node: int, wanted: CanObject, other: bytes) -> BadAnswer:
        what = Text("canopen_no_answer_to", node=node, bytes=other.hex(" "), wanted=str(wanted))
        return BadAnswer(what, bus=self.name, device=device)

    def _silence(
        self, device: str, node: int, what: str, waited_s: float, *, hurried: bool = False, others: bool = False
    ) -> DriverError:
        """others: it has just answered other requests"""
        self._doubtful.add(node)
        self._patience.missed(node)
        if (lost := self._network.notifier.exception) is not None:
            return interface_error(self.name, device, self._settings, lost)
        late = self._requests.was_heard(node)
        return NoAnswer(
            Text("canopen_silent", node=node, what=what, waited_s=waited_s),
            hurried=hurried,
            heard=late or others,
            bus=self.name,
            device=device,
            hint=Text("canopen_later" if late else "canopen_others" if others else "canopen_check"),
        )
