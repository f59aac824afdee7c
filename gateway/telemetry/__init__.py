"""What is published over Zenoh, and under which keys."""
