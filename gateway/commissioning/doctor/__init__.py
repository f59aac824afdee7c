"""What is wrong around a gateway on its computer, why it matters, and what to do. It reads files only."""
