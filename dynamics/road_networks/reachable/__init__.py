"""Where others can be on a network of roads, whatever they do, and who of two waits."""
