"""How it is learned: fits, rounds of fresh data, macro-steps, and how far predictions drift."""
