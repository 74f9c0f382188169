"""How things move: vehicles, roads, scenes and predictions, as pure functions of arrays."""
