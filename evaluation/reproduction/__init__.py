"""The experiments of the report that this project started from, by its text and by its published script."""
