"""Filters: one for each kind of action and road. A filter decides, supervises frames, and reports."""
