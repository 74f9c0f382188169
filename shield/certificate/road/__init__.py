"""What makes an action safe: manoeuvres, clauses, memory, monitor."""
