"""Running of episodes: settings, policies by name, records and the store."""
