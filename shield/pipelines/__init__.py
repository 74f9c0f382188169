"""How a decision is made, for each kind of action."""
