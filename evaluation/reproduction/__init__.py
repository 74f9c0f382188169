"""The experiments of the report that this project grew from, as its text and as its published script have them."""
