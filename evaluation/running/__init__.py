"""Driving episodes: settings, policies by name, records."""
