"""The runtime filter: overrides the actions of a driving policy that it cannot verify as safe."""
