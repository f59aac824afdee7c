"""Controls with an agent that speaks the protocol of docs/agent.md, and their values as channels."""
