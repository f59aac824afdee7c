"""The contract of docs/agent.md as clauses, each of which tests one promise on a running agent."""
