"""Replay of one episode: the recorded data, and an offline page that shows it."""
