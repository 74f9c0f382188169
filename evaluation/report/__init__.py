"""Results for people: tables and moving pictures."""
