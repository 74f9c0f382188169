"""What it is learned from: transitions, and where they come from."""
