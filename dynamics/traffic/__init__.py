"""What the others may do, and where they can be."""
