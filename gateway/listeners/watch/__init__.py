"""A running gateway on a terminal: an ordinary subscriber, drawn with rich."""
