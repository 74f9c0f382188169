"""Certificate on straight highways and racetracks: manoeuvres, clauses, memory and monitor."""
