"""Several sinks in order."""

from gateway.model.events import GatewayEvent, ProbingRequested, in_order


def test_each_sink_gets_an_event_before_the_next_event_comes() -> None:
    seen: list[tuple[str, GatewayEvent]] = []
    take = in_order([lambda event: seen.append(("first", event)), lambda event: seen.append(("second", event))])
    one, two = ProbingRequested(41), ProbingRequested(42)
    take(one)
    take(two)
    assert seen == [("first", one), ("second", one), ("first", two), ("second", two)]
