"""What the filter solves: one question, linearised, in the form that each solver is good at."""
