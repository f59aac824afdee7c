"""A CAN bus with CANopen nodes. The canopen library blocks, so it runs in threads that this bus owns and joins.

While connected there are two threads: one receives, one asks. The event loop never touches the library.
"""

import asyncio
import logging
import math
import queue
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import cycle
from time import monotonic, sleep
from typing import Any, TypeVar

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused
from drivers.can.bus import KeptFrame
from drivers.can.interface import interface_error, open_interface, shut
from drivers.can.receiver import Receiver
from drivers.canopen.events import NodeEvents
from drivers.canopen.frames import FittingAnswers, LatestFrames, pass_on
from drivers.canopen.place import CanObject
from drivers.canopen.settings import CanOpenSettings
from drivers.patience import LONGER, Patience
from drivers.rests import Rests
from drivers.tap import Tap
from drivers.text import Text

R = TypeVar("R")

_SYNC = 0x080
_SDO_READ = 0x40
_NMT_START = 1
_RESTS_S = (0.0, 0.002, 0.01, 0.05, 0.1, 0.2)
"""Rests after an answer that are tried one after the other."""
_LONGEST_NUMBER = 8
"""Bytes of the widest number that a node may hold. A transfer that never ends is aborted beyond that."""


logging.getLogger("canopen").setLevel(logging.CRITICAL)  # what it logs is raised here as an error

_NEVER_VALUES = CanObject(0x1000, 0), CanObject(0x1001, 0), CanObject(0x1018, 0)
"""Objects that every node has (CiA 301) and that no channel reads."""


class Uncounted(bytes):
    """Four bytes of which the node does not say how many count: as many as the object's type has (CiA 301)."""


class CanOpenBus:
    """Nodes on one CAN interface. Requests to all nodes queue for one thread."""

    kind = CanOpenSettings.bus_kind
    units = CanOpenSettings.units

    def __init__(self, name: str, settings: CanOpenSettings, tap: Tap | None = None) -> None:
        self.name, self.timeout_s = name, settings.timeout_s
        self._settings, self._tap = settings, tap
        self._network: Any = None
        self._thread: ThreadPoolExecutor | None = None
        self._patience = Patience(settings.timeout_s)
        self._until_s = math.inf
        self._doubtful: set[int] = set()
        self._never_values = cycle(_NEVER_VALUES)
        self._events: dict[int, NodeEvents] = {}
        self._unwatched: dict[int, Text] = {}
        self._rests = Rests(steps_s=_RESTS_S)
        self._fitting: dict[int, FittingAnswers] = {}
        self._frames = LatestFrames()
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
        fitting = self._fitting.get(node)
        frames_s = self._frames.doubled_s(identifiers)
        by_sdo = (-math.inf, "") if fitting is None else fitting.doubled
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
        if node not in self._network:
            dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
            self._network.add_node(canopen.RemoteNode(node, dictionary))
            # The library keeps every emergency without limit and fails on short heartbeats or commands: it gets none.
            for identifier in (0, 0x80 + node, 0x700 + node):
                self._network.unsubscribe(identifier)
            remote = self._network[node].sdo
            self._network.unsubscribe(remote.tx_cobid)
            self._fitting[node] = FittingAnswers(remote.on_response)
            self._network.subscribe(remote.tx_cobid, self._fitting[node].put)
            if not self._hears_itself:
                self._network.subscribe(remote.rx_cobid, self._fitting[node].other_asked)
            self._network.subscribe(0x80 + node, self.events(node).on_emergency)
            self._network.subscribe(0x700 + node, self.events(node).on_heartbeat)
        sdo = self._network[node].sdo
        if node in self._doubtful:
            self._let_late_answers_pass(sdo, device, node)
        return [self._one(sdo, device, node, wanted, most_bytes) for wanted in objects]

    def _let_late_answers_pass(self, sdo: Any, device: str, node: int) -> None:
        """Ask for an object that is never a value, and wait for its answer. A node answers in order: nothing older
        follows.

        The library would give up at a late answer. Each call asks for a different object, in case the answer to this
        one is late too.
        """
        wanted = next(self._never_values)
        address = wanted.index.to_bytes(2, "little") + bytes((wanted.subindex,))
        sdo.responses = queue.Queue()
        self._fitting[node].expect(wanted)
        self._let_rest(node)
        self._send(device, sdo.rx_cobid, bytes((_SDO_READ,)) + address + bytes(4))
        asked_s = monotonic()
        try:
            while sdo.responses.get(timeout=max(0.0, asked_s + self._longest_s(node) - monotonic()))[1:4] != address:
                pass
        except queue.Empty:
            if self._fitting[node].late:
                raise self._silence(device, node, Text("no_answer"), self._longest_s(node)) from None
            raise self._unanswered(device, node, wanted, self._longest_s(node)) from None
        self._rests.answered(node, monotonic())
        self._fitting[node].is_in_order()
        self._doubtful.discard(node)

    def _let_rest(self, node: int) -> None:
        """Wait for as long as the node needs after its last answer; it is asked then."""
        sleep(max(0.0, self._rests.left_s(node, monotonic(), first=True)))
        self._rests.sent(node, monotonic())

    def _synchronise(self, device: str, node: int, identifiers: Sequence[int]) -> dict[int, KeptFrame]:
        """Every node answers each SYNC, whichever it was sent for. One that was sent just before, after the node's last
        read, serves it too: a second one might overtake frames of the first, and the status of one moment would pass
        for that of another."""
        last_s, taken_s = self._synchronised_s, self._taken_s.get(node, math.inf)
        if node not in self._taken_s or taken_s < last_s < monotonic() - self._settings.timeout_s:
            self._doubtful.add(node)
        if node in self._doubtful:
            self._upload(device, node, ())  # frames of an earlier SYNC arrive before this answer
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

    def _one(self, sdo: Any, device: str, node: int, wanted: CanObject, most_bytes: int) -> bytes:
        data = b""
        longest_s = self._longest_s(node)
        is_slow = longest_s > self._settings.timeout_s
        sdo.RESPONSE_TIMEOUT = longest_s if is_slow else min(longest_s, self._patience.wait_s(node, wanted))
        self._let_rest(node)
        self._fitting[node].expect(wanted)
        asked_s = monotonic()
        try:
            with sdo.open(wanted.index, wanted.subindex, buffering=0) as segments:
                while len(data) <= most_bytes:
                    if self._fitting[node].in_segments:
                        self._rests.answered(node, monotonic())
                        self._let_rest(node)
                    if not (segment := segments.read(most_bytes)):
                        break
                    data += segment
            if segments.exp_data is not None and segments.size is None:
                data = Uncounted(data)
        except SdoAbortedError as error:
            self._rests.answered(node, monotonic())
            raise Refused(
                Text("canopen_refused", node=node, wanted=str(wanted), error=str(error)),
                bus=self.name,
                device=device,
                hint=Text("profile_fits"),
            ) from error
        except SdoCommunicationError as error:
            raise self._communication(device, node, wanted, error, sdo.RESPONSE_TIMEOUT) from error
        except (can.CanError, OSError) as error:
            raise interface_error(self.name, device, self._settings, error) from error
        if not 0 < len(data) <= most_bytes:
            self._doubtful.add(node)
            size = Text("more_bytes", most=most_bytes) if data else Text("canopen_nothing")
            raise BadAnswer(
                Text("canopen_holds", node=node, wanted=str(wanted), size=size), bus=self.name, device=device
            )
        if segments.size and len(data) != segments.size:
            what = Text("canopen_sent", node=node, count=len(data), wanted=str(wanted), size=segments.size)
            raise BadAnswer(what, bus=self.name, device=device)
        self._patience.answered(node, wanted, monotonic() - asked_s)
        self._rests.answered(node, monotonic())
        return data

    def limit(self, left_s: float) -> None:
        self._until_s = monotonic() + left_s

    def _longest_s(self, node: int) -> float:
        """How long an answer may take: longer than the timeout, if that is not enough and no other node waits; when all
        have been asked, as long as is left."""
        late_s = self._patience.late_s(LONGER * self._fitting[node].late_s)
        left_s = self._until_s - monotonic()
        if math.isfinite(left_s):
            return max(0.0, min(late_s, left_s))
        return late_s if len(self._fitting) == 1 else self._settings.timeout_s

    def _communication(
        self, device: str, node: int, wanted: CanObject, error: Exception, waited_s: float
    ) -> DriverError:
        if isinstance(error.__context__, queue.Empty):  # canopen's queue of responses
            return self._unanswered(device, node, wanted, waited_s)
        self._doubtful.add(node)
        return BadAnswer(
            Text("canopen_object_error", node=node, wanted=str(wanted), error=str(error)), bus=self.name, device=device
        )

    def _unanswered(self, device: str, node: int, wanted: CanObject, waited_s: float) -> DriverError:
        now_s = monotonic()
        if not self._fitting[node].late:
            self._rests.missed(node, now_s)
        hurried = waited_s < self._settings.timeout_s
        others = self._rests.answered_s(node) >= now_s - waited_s - self._settings.timeout_s
        silence = self._silence(device, node, Text("no_answer"), waited_s, hurried=hurried, others=others)
        if not (other := self._fitting[node].other) or not isinstance(silence, NoAnswer):
            return silence
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
        late = node in self._fitting and self._fitting[node].late
        return NoAnswer(
            Text("canopen_silent", node=node, what=what, waited_s=waited_s),
            hurried=hurried,
            heard=late or others,
            bus=self.name,
            device=device,
            hint=Text("canopen_later" if late else "canopen_others" if others else "canopen_check"),
        )
