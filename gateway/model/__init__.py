"""What happens, and what a person may order, as types that every room of the gateway shares."""

__all__ = ["commands", "events"]
