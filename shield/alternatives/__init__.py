"""What takes the place of a proposal that does not verify."""
