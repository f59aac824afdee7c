"""Several sinks in order."""

from gateway.model.events import Events, GatewayEvent, ProbingRequested, StorageChanged, StoreHealth


def test_each_sink_gets_an_event_before_the_next_event_comes() -> None:
    seen: list[tuple[str, GatewayEvent]] = []
    take = Events(lambda event: seen.append(("first", event)), lambda event: seen.append(("second", event))).publish
    one, two = ProbingRequested(41), ProbingRequested(42)
    take(one)
    take(two)
    assert seen == [("first", one), ("second", one), ("first", two), ("second", two)]


def test_a_subscriber_gets_the_events_of_its_type_alone() -> None:
    seen: list[int] = []
    events = Events()
    events.subscribe(ProbingRequested, lambda request: seen.append(request.number))
    events.publish(ProbingRequested(41))
    events.publish(StorageChanged(StoreHealth()))
    assert seen == [41]
