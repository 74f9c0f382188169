"""Rare events: how often what hardly ever happens does, and the worst that can."""
