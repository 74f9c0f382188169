"""Alternatives to a proposal that does not verify."""
